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
from jaxtyping import Array, Bool, Float, Int

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


class Stated(NamedTuple):
    """Measurements as arrays of n rows, some of which are empty.

    Attributes:
        kind: (n,) index into `QUANTITIES`.
        camera: (n,) index of the camera.
        pixels: (n, 4) two pixels from the image center.
        value: (n, 3) the stated numbers.
        present: (n, 3) mask of the numbers that a row has.
        sd: (n,) standard deviation of each number.
        pixel_sd: (n,) standard deviation of each pixel coordinate.
    """

    kind: Int[Array, " n"]
    camera: Int[Array, " n"]
    pixels: Float[Array, "n 4"]
    value: Float[Array, "n 3"]
    present: Bool[Array, "n 3"]
    sd: Float[Array, " n"]
    pixel_sd: Float[Array, " n"]


class Linearized(NamedTuple):
    """Stated numbers compared with those predicted from cameras and a map frame; 0 if absent.

    Attributes:
        slopes: (n, 3, 7C + 4) derivatives of the predictions with respect to the cameras and the
            map frame.
        noise: (n, 3, 3) covariance of each stated value, including that of its pixels.
        off: (n, 3) stated minus predicted, angles modulo a full turn.
    """

    slopes: Float[Array, "n 3 k"]
    noise: Float[Array, "n 3 3"]
    off: Float[Array, "n 3"]


def stack(measurements: Sequence[Measurement]) -> Stated:
    """Stack measurements, padded with empty rows so that few sizes are compiled."""
    count = len(measurements)
    sizes = np.array([len(m.value) for m in measurements], int)
    present = np.arange(3) < sizes[:, None]
    value = np.zeros((count, 3))
    value[present] = [v for m in measurements for v in m.value]
    rows = (
        np.array([m.kind for m in measurements], int),
        np.array([m.camera for m in measurements], int),
        np.array([m.pixels for m in measurements]).reshape(-1, 4),
        value,
        present,
        np.array([m.sd for m in measurements]),
        np.array([m.pixel_sd for m in measurements]),
    )
    length = max(count + -count % 8, 8)
    return Stated(*(padded(array, length) for array in rows))


@jax.jit
def linearize(
    stated: Stated, cameras: Float[Array, "cam 7"], frame: Float[Array, "4"]
) -> Linearized:
    """Compare stated numbers with those predicted from cameras and a map frame.

    Args:
        stated: (n,) measurements.
        cameras: (C, 7) in the frame of the people.
        frame: (4,) the map frame.
    """
    axes = (0, None, 0, 0)
    given = cameras[stated.camera], frame, stated.pixels, stated.kind
    derivatives: Any = jax.jacfwd(quantity, (0, 1, 2))
    value = jax.vmap(quantity, axes)(*given)
    by_camera, by_frame, by_pixel = jax.vmap(derivatives, axes)(*given)
    own = jax.nn.one_hot(stated.camera, len(cameras), dtype=value.dtype)
    by_cameras = by_camera[:, :, None, :] * own[:, None, :, None]
    slopes = jnp.concatenate([by_cameras.reshape(*value.shape, cameras.size), by_frame], -1)
    off = stated.value - value
    turned = stated.kind[:, None] == ROTATION
    off = jnp.where(turned, (off + jnp.pi) % (2 * jnp.pi) - jnp.pi, off)
    variance, of_pixels = stated.sd[:, None, None] ** 2, stated.pixel_sd[:, None, None] ** 2
    noise = variance * jnp.eye(3, dtype=value.dtype)[None] + of_pixels * by_pixel @ by_pixel.mT
    present = stated.present[:, :, None]
    return Linearized(
        jnp.where(present, slopes, 0),
        jnp.where(present & present.mT, noise, 0),
        jnp.where(stated.present, off, 0),
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
