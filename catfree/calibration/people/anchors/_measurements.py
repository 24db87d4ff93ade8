"""Measurements of anchors as functions of a camera and the map frame.

A rig from people has a frame of its own, with its crowd as the unit: meters if the people's mean
height is that of the settings. A map frame (log scale, heading in radians, x, y) transforms it to
meters and to the coordinates of the anchors.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy  # scipy.linalg is slow to import, so it is loaded on use
from jaxtyping import Array, Float, Int

from catfree.calibration.people._radial_lens import ideal_pixels
from catfree.calibration.people.anchors._anchors import (
    Anchor,
    KnownCamera,
    KnownDistance,
    SurveyedPoint,
)
from catfree.calibration.people.cameras._camera_model import (
    LOG_FOCAL,
    PAN,
    TILT,
    X,
    Y,
    Z,
    from_matrices,
    rotation,
)
from catfree.geometry._buckets import padded
from catfree.types import GeoReference, Rig

QUANTITIES = ("distance", "height", "focal length", "position", "rotation", "point", "people")
DISTANCE, HEIGHT, FOCAL, POSITION, ROTATION, POINT, PEOPLE = range(7)
LEAST_FALL = 1e-3  # of a ray per unit of length; flatter rays hardly meet the ground
NEAREST = 1e-6  # meters; a shorter length has no direction


class Measurement(NamedTuple):
    """One stated quantity.

    Attributes:
        anchor: the anchor that states it; None for the height of the people.
        kind: index into `QUANTITIES`; lengths are logarithms, the people's height relative to the
            expected one.
        camera: index of the camera; arbitrary for the people.
        pixels: (2, 2) in pixels from the image center of an ideal camera; arbitrary if the quantity
            has none.
        value: (d,) the stated value.
        sd: standard deviation of each of its numbers.
        pixel_sd: standard deviation of each pixel coordinate.
    """

    anchor: Anchor | None
    kind: int
    camera: int
    pixels: Float[np.ndarray, "2 2"]
    value: Float[np.ndarray, " d"]
    sd: float
    pixel_sd: float


def measurements_of(
    anchors: Sequence[Anchor],
    cameras: Sequence[int],
    rig: Rig,
    earth: GeoReference | None,
) -> list[Measurement]:
    """Split anchors into the quantities that they state.

    Args:
        anchors: the anchors.
        cameras: camera index of each anchor.
        rig: the cameras, whose distortion is removed from pixels.
        earth: where the map frame is, if anchors have longitudes and latitudes.
    """
    measurements = []
    for anchor, camera in zip(anchors, cameras, strict=True):
        pixels, pixel_sd = np.zeros((2, 2)), 0.0
        if isinstance(anchor, KnownDistance):
            pixels = np.array(anchor.pixels, np.float64)
            pixel_sd = anchor.pixel_sd
            stated = [(DISTANCE, np.log(anchor.meters), anchor.sd / anchor.meters)]
        elif isinstance(anchor, SurveyedPoint):
            pixels = np.array([anchor.pixel] * 2, np.float64)
            pixel_sd = anchor.pixel_sd
            stated = [(POINT, _position(anchor, earth), anchor.sd)]
        else:
            stated = []
            if anchor.height is not None:
                stated.append((HEIGHT, np.log(anchor.height), anchor.height_sd / anchor.height))
            if anchor.focal is not None:
                stated.append((FOCAL, np.log(anchor.focal), anchor.focal_sd / anchor.focal))
            if (position := _position(anchor, earth)) is not None:
                stated.append((POSITION, position, anchor.position_sd))
            if anchor.rotation is not None:
                R = np.array([anchor.rotation], np.float64)
                angles = from_matrices(np.eye(3)[None], R, np.zeros((1, 3)))[0, TILT : PAN + 1]
                stated.append((ROTATION, angles, np.deg2rad(anchor.rotation_sd)))
        pixels = ideal_pixels(rig, np.full(2, camera), pixels)
        for kind, value, sd in stated:
            values = np.atleast_1d(np.asarray(value, np.float64))
            measurements.append(
                Measurement(anchor, kind, camera, pixels, values, float(sd), pixel_sd)
            )
    return measurements


def _position(anchor: KnownCamera | SurveyedPoint, earth: GeoReference | None) -> Any:
    """Position in meters of the map frame, (2,) or (3,), or None."""
    if earth is None or anchor.longitude is None:
        return anchor.position
    return earth.to_xy([[anchor.longitude, anchor.latitude]])[0]


def on_map(camera: Float[Array, "7"], frame: Float[Array, "4"]) -> Float[Array, "7"]:
    """Move a camera into the map frame (log scale, heading in radians, x, y)."""
    scale, c, s = jnp.exp(frame[0]), jnp.cos(frame[1]), jnp.sin(frame[1])
    x = scale * (c * camera[X] - s * camera[Y]) + frame[2]
    y = scale * (s * camera[X] + c * camera[Y]) + frame[3]
    moved = jnp.stack([camera[PAN] + frame[1], x, y, scale * camera[Z]])
    return jnp.concatenate([camera[:PAN], moved])


def ground_of_pixel(camera: Float[Array, "7"], pixel: Float[Array, "2"]) -> Float[Array, "2"]:
    """Intersect the ray of a pixel, relative to the image center, with the ground z = 0.

    Rays that do not fall are taken to meet it very far away.
    """
    ray = rotation(camera).T @ jnp.append(pixel / jnp.exp(camera[LOG_FOCAL]), 1.0)
    fall = -ray[2] / jnp.sqrt(ray @ ray)
    down = jnp.where(fall > LEAST_FALL, -ray[2], LEAST_FALL)
    return camera[X:Z] + camera[Z] * ray[:2] / down


def quantity(
    camera: Float[Array, "7"],
    frame: Float[Array, "4"],
    pixels: Float[Array, "4"],
    kind: Int[Array, ""],
) -> Float[Array, "3"]:
    """Compute a quantity of `QUANTITIES` for a camera, padded with zeros."""
    placed = on_map(camera, frame)
    first, second = ground_of_pixel(placed, pixels[:2]), ground_of_pixel(placed, pixels[2:])
    away, zero = first - second, jnp.zeros((), placed.dtype)
    distance = jnp.log(jnp.maximum(jnp.sum(away**2), NEAREST**2)) / 2
    height, focal = jnp.log(jnp.maximum(placed[Z], NEAREST)), placed[LOG_FOCAL]
    distance, height, focal, people = (
        jnp.stack([value, zero, zero]) for value in (distance, height, focal, frame[0])
    )
    position, angles, point = placed[X:], placed[TILT : PAN + 1], jnp.append(first, zero)
    return jnp.stack([distance, height, focal, position, angles, point, people])[kind]


@jax.jit
def _quantities(
    camera: Float[Array, "n 7"],
    frame: Float[Array, "4"],
    pixels: Float[Array, "n 4"],
    kind: Int[Array, " n"],
) -> tuple[Array, tuple[Array, Array, Array]]:
    axes = (0, None, 0, 0)
    value = jax.vmap(quantity, axes)(camera, frame, pixels, kind)
    derivatives: Any = jax.jacfwd(quantity, (0, 1, 2))
    return value, jax.vmap(derivatives, axes)(camera, frame, pixels, kind)


def linearize(
    measurements: Sequence[Measurement],
    cameras: Float[np.ndarray, "cam 7"],
    frame: Float[np.ndarray, "4"],
) -> tuple[Float[np.ndarray, "k n"], list[Float[np.ndarray, "d d"]], Float[np.ndarray, " k"]]:
    """Compare k stated numbers with those predicted from cameras and a map frame.

    Returns:
        (k, 7C + 4) derivatives of the predictions with respect to the cameras and the map frame;
        (d, d) covariance of each stated value, including that of its pixels; and (k,) stated minus
        predicted, angles modulo a full turn.
    """
    count = len(measurements)
    length = max(count + -count % 8, 8)  # padded, so that few sizes are compiled
    camera = np.array([m.camera for m in measurements], int)
    pixels = np.array([m.pixels for m in measurements]).reshape(-1, 4)
    kind = np.array([m.kind for m in measurements], int)
    with jax.enable_x64(True):
        value, slopes = _quantities(
            padded(cameras[camera], length),
            jnp.asarray(frame),
            padded(pixels, length),
            padded(kind, length),
        )
        value, by_camera, by_frame, by_pixel = (np.asarray(a)[:count] for a in (value, *slopes))
    sizes = np.array([len(m.value) for m in measurements], int)
    owner, row = np.nonzero(np.arange(3) < sizes[:, None])
    by_cameras = np.zeros((len(owner), *cameras.shape))
    by_cameras[np.arange(len(owner)), camera[owner]] = by_camera[owner, row]
    off = np.array([v for m in measurements for v in m.value]) - value[owner, row]
    noise = [
        m.sd**2 * np.eye(size) + m.pixel_sd**2 * slope[:size] @ slope[:size].T
        for m, slope, size in zip(measurements, by_pixel, sizes, strict=True)
    ]
    return (
        np.hstack([by_cameras.reshape(len(owner), cameras.size), by_frame[owner, row]]),
        noise,
        np.where(kind[owner] == ROTATION, (off + np.pi) % (2 * np.pi) - np.pi, off),
    )


@jax.jit
def _map_cameras(
    cameras: Float[Array, "cam 7"], frame: Float[Array, "4"]
) -> tuple[Array, tuple[Array, Array]]:
    moved = jax.vmap(on_map, (0, None))(cameras, frame)
    return moved, jax.vmap(jax.jacfwd(on_map, (0, 1)), (0, None))(cameras, frame)


def map_cameras(
    cameras: Float[np.ndarray, "cam 7"], frame: Float[np.ndarray, "4"]
) -> tuple[Float[np.ndarray, "cam 7"], Float[np.ndarray, "n m"]]:
    """Move (C, 7) cameras into a map frame (4,), with derivatives (7C, 7C + 4) by both."""
    with jax.enable_x64(True):
        moved, (by_camera, by_frame) = _map_cameras(jnp.asarray(cameras), jnp.asarray(frame))
        J = np.hstack(
            [scipy.linalg.block_diag(*np.asarray(by_camera)), np.reshape(by_frame, (-1, 4))]
        )
        return np.asarray(moved), J
