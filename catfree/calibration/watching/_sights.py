"""What all cameras saw: boxes as angles in their cameras, and people as states on the ground.

An angle is an azimuth or an elevation in the axes of a camera: a turn of a camera moves all of its
boxes by nearly the same angles, whatever its lens.

The error of a camera is an array of 8 numbers: its turn, a rotation vector in its axes in radians;
its lag, the steps by which it shows an earlier instant than its frame numbers say; the displacement
of its center along the ground's axes and upward, in person heights; and its zoom, the natural log
by which its focal length is longer.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from catfree.geometry._buckets import in_blocks
from catfree.geometry._person import edges_of, visible_foot
from catfree.geometry.camera import pixels_of_points, rays_of_pixels
from catfree.settings._calibration_settings import FOOT_AHEAD
from catfree.types import Detections, Scene, Tracks
from catfree.types._sampling import frame_step

PARAMETERS = 8  # of the error of a camera
TURN, LAG, CENTER, ZOOM = slice(0, 3), slice(3, 4), slice(4, 7), slice(7, 8)
LAGS = slice(3, None, PARAMETERS)  # of all cameras, whose errors follow each other
BORDER = 0.005  # of the image side; a box that ends nearer to its border may be cut by it
HEIGHTS = (0.7, 1.3)  # of the median height; bounds of the height of one person
BLOCK = 512  # sightings computed together


@dataclass(frozen=True)
class SightedBoxes:
    """Boxes as angles in the axes of their cameras, sorted by camera, then frame.

    Attributes:
        frame: (N,) frame numbers, in steps from the first.
        camera: (N,) the camera.
        angle: (N, 3) azimuth of the center, elevation of the top and of the bottom, in radians, the
            elevation positive downward.
        size: (N,) the angular height.
        height: (N,) the height in pixels.
        whole: (N, 3) whether an edge is free of the image border.
    """

    frame: Int[np.ndarray, " n"]
    camera: Int[np.ndarray, " n"]
    angle: Float[np.ndarray, "n 3"]
    size: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]
    whole: Bool[np.ndarray, "n 3"]

    def of_camera(self, camera: int) -> slice:
        """The rows of one camera."""
        return slice(*np.searchsorted(self.camera, [camera, camera + 1]).tolist())


@dataclass(frozen=True)
class SightedPeople:
    """Positions of tracks, sorted by frame.

    Attributes:
        frame: (M,) frame numbers, in steps from the first.
        track: (M,) identity.
        state: (M, 3) ground position and height in scene units.
        velocity: (M, 2) scene units per step; zero where unknown.
        support: (M, C) row of the caller's detections, or -1.
    """

    frame: Int[np.ndarray, " m"]
    track: Int[np.ndarray, " m"]
    state: Float[np.ndarray, "m 3"]
    velocity: Float[np.ndarray, "m 2"]
    support: Int[np.ndarray, "m cam"]

    def between(self, begin: int, stop: int) -> Int[np.ndarray, " k"]:
        """(k,) the people from step `begin` to before `stop`."""
        return np.arange(*np.searchsorted(self.frame, [begin, stop]))

    def seen_by_others(self, camera: int, person: Int[np.ndarray, " k"]) -> Int[np.ndarray, " n"]:
        """(n,) those of the people whom two or more other cameras see."""
        has_box = self.support[person] >= 0
        return person[has_box.sum(-1) - has_box[:, camera] >= 2]


@dataclass(frozen=True)
class Sights:
    """A recording as the cameras of a scene saw it.

    Attributes:
        scene: cameras and ground.
        place: (C, 3, 4) map from homogeneous ground coordinates and height to camera axes.
        boxes: of registered cameras.
        people: of all tracks.
        unit: median height of people in scene units.
        first: frame number of step 0.
        step: frame numbers per step.
        steps: length of the recording in steps.
        detections: the boxes as they were given.
    """

    scene: Scene
    place: Float[np.ndarray, "cam 3 4"]
    boxes: SightedBoxes
    people: SightedPeople
    unit: float
    first: int
    step: int
    steps: int
    detections: Detections

    def frame(self, step: int) -> int:
        """Frame number of a step."""
        return self.first + step * self.step

    def imaged(
        self, camera: Int[np.ndarray, " n"], state: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Mark the people whose middle lies in the image of a camera, (n,)."""
        ground = self.scene.ground
        basis, normal = (np.asarray(v, np.float64) for v in (ground.basis, ground.normal))
        height = state[:, 2:] / 2 - float(ground.offset)
        pixel, is_imaged = pixels_of_points(
            self.scene.rig, camera, state[:, :2] @ basis.T + height * normal
        )
        size = np.asarray(self.scene.rig.image_size)[camera]
        with np.errstate(invalid="ignore"):
            return is_imaged & ((pixel >= 0) & (pixel <= size - 1)).all(-1)


def sights(scene: Scene, detections: Detections, tracks: Tracks) -> Sights:
    """Express boxes and tracks as angles and states.

    Args:
        scene: cameras and ground.
        detections: (N,) boxes, at least one.
        tracks: of these boxes, whose `support` is known.
    """
    frames = np.unique(detections.frame)
    step = frame_step(frames)
    first = int(frames[0])
    place = _places(scene)
    boxes = _boxes(scene, detections, first, step)
    people, unit = _people(scene, detections, tracks, place, first, step)
    steps = (int(frames[-1]) - first) // step + 1
    return Sights(scene, place, boxes, people, unit, first, step, steps, detections)


def with_cameras(sights: Sights, camera: Int[np.ndarray, " n"]) -> Sights:
    """Assign each box to the camera given for it; the people stay as they are."""
    detections = replace(sights.detections, camera=camera)
    boxes = _boxes(sights.scene, detections, sights.first, sights.step)
    return replace(sights, boxes=boxes, detections=detections)


def _places(scene: Scene) -> Float[np.ndarray, "cam 3 4"]:
    rig, ground = scene.rig, scene.ground
    R, t = (np.asarray(part, np.float64) for part in (rig.R, rig.t))
    basis, normal = (np.asarray(v, np.float64) for v in (ground.basis, ground.normal))
    turn = R @ np.column_stack([basis, normal])
    place = t - R @ (float(ground.offset) * normal)
    joined = np.concatenate([turn, place[..., None]], -1)
    return np.where(np.asarray(rig.registered)[:, None, None], joined, np.eye(3, 4))


def _boxes(scene: Scene, detections: Detections, first: int, step: int) -> SightedBoxes:
    rig = scene.rig
    row = np.flatnonzero(np.asarray(rig.registered)[detections.camera])
    row = row[np.lexsort((detections.frame[row], detections.camera[row]))]
    camera, box = detections.camera[row], np.asarray(detections.box, np.float64)[row]
    middle = (box[:, 0] + box[:, 2]) / 2
    R = np.asarray(rig.R, np.float64)[camera]

    def direction(row: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Azimuth and elevation of the middle of an edge."""
        ray = rays_of_pixels(rig, camera, np.column_stack([middle, row]))
        x, y, z = np.einsum("nij,nj->in", R, ray)
        return np.column_stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])

    angle = edges_of(direction(box[:, 1]), direction(box[:, 3]))
    size = np.asarray(rig.image_size, np.float64)[camera]
    near, far = BORDER * size, (1 - BORDER) * size - 1
    whole = np.column_stack(
        [
            (box[:, 0] > near[:, 0]) & (box[:, 2] < far[:, 0]),
            box[:, 1] > near[:, 1],
            box[:, 3] < far[:, 1],
        ]
    )
    frame, height = (detections.frame[row] - first) // step, box[:, 3] - box[:, 1]
    return SightedBoxes(frame, camera, angle, angle[:, 2] - angle[:, 1], height, whole)


def _people(
    scene: Scene,
    detections: Detections,
    tracks: Tracks,
    place: Float[np.ndarray, "cam 3 4"],
    first: int,
    step: int,
) -> tuple[SightedPeople, float]:
    """Tracks with the height that their boxes imply."""
    at = np.flatnonzero((tracks.track_id >= 0) & (tracks.frame - first >= 0))
    xy, support = np.asarray(tracks.ground_xy, np.float64)[at], tracks.support[at]
    person, camera = np.nonzero(support >= 0)
    box = np.asarray(detections.box, np.float64)[support[person, camera]]
    top = np.column_stack([(box[:, 0] + box[:, 2]) / 2, box[:, 1]])
    R = np.asarray(scene.rig.R, np.float64)[camera]
    ray = np.einsum("nij,nj->ni", R, rays_of_pixels(scene.rig, camera, top))
    # The height at which a vertical line comes nearest to the elevation of the box's top.
    base = place[camera, :, :2] @ xy[person, :, None]
    base = base[..., 0] + place[camera, :, 3]
    up = place[camera, :, 2]
    across = np.column_stack([-ray[:, 1], np.hypot(ray[:, 0], ray[:, 2])])

    def tilted(v: np.ndarray) -> np.ndarray:
        """How far a point lies below the ray, in the plane through the camera's axis."""
        forward = (v[:, 0] * ray[:, 0] + v[:, 2] * ray[:, 2]) / np.maximum(across[:, 1], 1e-9)
        return forward * across[:, 0] + v[:, 1] * across[:, 1]

    slope = tilted(up)
    good = np.abs(slope) > 1e-6
    height = np.where(good, -tilted(base) / np.where(good, slope, 1.0), np.nan)
    known = np.isfinite(height) & (height > 0)
    unit = float(np.median(height[known])) if known.any() else float(scene.extent) / 12
    track = tracks.track_id[at]
    tall = np.full(len(track), unit)
    for one in np.unique(track):
        mine = known & (track[person] == one)
        if mine.any():
            tall[track == one] = np.median(height[mine])
    tall = np.clip(tall, HEIGHTS[0] * unit, HEIGHTS[1] * unit)
    velocity = np.nan_to_num(np.asarray(tracks.velocity, np.float64)[at]) * step
    state = np.column_stack([xy, tall])
    return SightedPeople((tracks.frame[at] - first) // step, track, state, velocity, support), unit


def predict_angles(
    error: Float[Array, "8"],
    state: Float[Array, "3"],
    velocity: Float[Array, "2"],
    place: Float[Array, "3 4"],
) -> Float[Array, "3"]:
    """Predict the angles of a person's box in a camera.

    Args:
        error: (8,) of the camera, its turn exact to first order, its displacement in scene units.
        state: (3,) ground position and height.
        velocity: (2,) per step.
        place: (3, 4) map to the camera's axes.

    Returns:
        (3,) azimuth of the center, elevation of head and foot in radians; finite everywhere.
    """
    (x, y), height = state[:2] - error[LAG] * velocity, state[2]
    one, zero = jnp.ones((), state.dtype), jnp.zeros((), state.dtype)
    moved = place[:, 3] - place[:, :3] @ error[CENTER]
    place = jnp.concatenate([place[:, :3], moved[:, None]], 1)
    # The axes are orthogonal, but not all of length 1 (see `corrected_place`).
    length = jnp.maximum((place[:, :3] ** 2).sum(1), 1e-12)
    station = -place[:, :2].T @ (place[:, 3] / length)
    foot_x, foot_y = visible_foot(jnp.stack([x, y]), station, FOOT_AHEAD * height)

    def direction(point: Float[Array, "4"]) -> Float[Array, "2"]:
        v = place @ point
        x, y, z = v + jnp.cross(error[TURN], v)
        z = z * jnp.exp(-error[ZOOM.start])
        flat = jnp.sqrt(jnp.maximum(x**2 + z**2, 1e-12))
        # The azimuth is finite, with its gradient, for a point at the camera.
        depth = jnp.where(jnp.abs(x) + jnp.abs(z) > 1e-6, z, 1e-6)
        return jnp.stack([jnp.arctan2(x, depth), jnp.arctan2(y, flat)])

    head, foot = jnp.stack([x, y, height, one]), jnp.stack([foot_x, foot_y, zero, one])
    return edges_of(direction(head), direction(foot))


@jax.jit
@jax.vmap
def _predicted(state: Array, velocity: Array, place: Array) -> Array:
    return predict_angles(jnp.zeros(PARAMETERS, state.dtype), state, velocity, place)


@jax.jit
@jax.vmap
def _linear(state: Array, velocity: Array, place: Array) -> tuple[Array, Array]:
    def shifted(error: Array, state: Array) -> tuple[Array, Array]:
        angles = predict_angles(error, state, velocity, place)
        return angles, angles

    right = jnp.zeros(PARAMETERS, state.dtype)
    slopes, value = jax.jacfwd(shifted, (0, 1), has_aux=True)(right, state)
    return value, jnp.concatenate(slopes, 1)


def predicted(
    state: Float[np.ndarray, "n 3"],
    velocity: Float[np.ndarray, "n 2"],
    place: Float[np.ndarray, "n 3 4"],
) -> Float[np.ndarray, "n 3"]:
    """`predict_angles` for n sightings of cameras without errors."""
    with jax.enable_x64(True):
        return in_blocks(_predicted, (state, velocity, place), BLOCK)


def linear(
    state: Float[np.ndarray, "n 3"],
    velocity: Float[np.ndarray, "n 2"],
    place: Float[np.ndarray, "n 3 4"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 11"]]:
    """`predicted`, and its derivatives by the error of the camera (8) and the state (3)."""
    with jax.enable_x64(True):
        return in_blocks(_linear, (state, velocity, place), BLOCK)
