"""Sightings of all cameras: boxes as angles in camera axes, people as states on the ground.

An angle is an azimuth or an elevation in camera axes: a turn of a camera moves all of its boxes by
nearly the same angles, whatever its lens.

The error of a camera is an array of 8 numbers: its turn, a rotation vector in its axes in radians;
its lag, the steps by which its frame numbers are ahead of the instant that it shows; the
displacement of its center along the ground's axes and upward, in person heights; and its zoom, the
natural logarithm of the growth of its focal length.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from catfree.errors import InsufficientDataError
from catfree.geometry._buckets import in_blocks
from catfree.geometry._person import cut_by_border, edges_of, heights_by_boxes, visible_foot
from catfree.geometry.camera import pixels_of_points, rays_of_pixels
from catfree.settings import EvidenceSettings, Settings
from catfree.settings._calibration_settings import FOOT_AHEAD
from catfree.types import Detections, Localization, Scene
from catfree.types._detections import is_confident
from catfree.types._sampling import frame_step

PARAMETERS = 8  # of the error of a camera
TURN, LAG, CENTER, ZOOM = slice(0, 3), slice(3, 4), slice(4, 7), slice(7, 8)
LAGS = slice(3, None, PARAMETERS)  # of all cameras, whose errors are concatenated
FLOOR = 0.001  # radians; edge noise in addition to a share of the box height
HEIGHTS = (0.7, 1.3)  # of the median height; bounds of a person's height
BLOCK = 512  # sightings computed together


@dataclass(frozen=True)
class SightedBoxes:
    """Boxes as angles in the axes of their cameras, sorted by camera, then frame.

    Attributes:
        frame: (N,) frame numbers, in steps from the first.
        camera: (N,) the camera.
        angle: (N, 3) azimuth of the center, elevation of the top and of the bottom, in radians, the
            elevation positive downward.
        deviation: (N, 3) standard deviations of `angle`.
        size: (N,) the angular height.
        height: (N,) the height in pixels.
        whole: (N, 3) whether an edge is not cut by the image border.
    """

    frame: Int[np.ndarray, " n"]
    camera: Int[np.ndarray, " n"]
    angle: Float[np.ndarray, "n 3"]
    deviation: Float[np.ndarray, "n 3"]
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
        seen: (M, C) whether a box of each camera shows the person.
    """

    frame: Int[np.ndarray, " m"]
    track: Int[np.ndarray, " m"]
    state: Float[np.ndarray, "m 3"]
    velocity: Float[np.ndarray, "m 2"]
    seen: Bool[np.ndarray, "m cam"]

    def between(self, begin: int, stop: int) -> Int[np.ndarray, " k"]:
        """(k,) the people from step `begin` up to, but not including, `stop`."""
        return np.arange(*np.searchsorted(self.frame, [begin, stop]))

    def seen_by_others(self, camera: int, person: Int[np.ndarray, " k"]) -> Int[np.ndarray, " n"]:
        """(n,) those of the people seen by two or more other cameras."""
        seen = self.seen[person]
        return person[seen.sum(-1) - seen[:, camera] >= 2]


@dataclass(frozen=True)
class Sights:
    """A recording as seen by the cameras of a scene.

    Attributes:
        scene: cameras and ground.
        place: (C, 3, 4) map from homogeneous ground coordinates and height to camera axes.
        boxes: boxes of registered cameras.
        people: people of all tracks.
        unit: median height of people in scene units.
        first: frame number of step 0.
        step: frame numbers per step.
        steps: length of the recording in steps.
        detections: the confident boxes as given.
        settings: as given.
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
    settings: Settings

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
        size = self.scene.rig.image_size[camera]
        with np.errstate(invalid="ignore"):
            return is_imaged & ((pixel >= 0) & (pixel <= size - 1)).all(-1)


def sights(
    scene: Scene, detections: Detections, localization: Localization, settings: Settings
) -> Sights:
    """Express boxes and tracks as angles and states.

    Args:
        scene: cameras and ground.
        detections: (N,) boxes.
        localization: localization of these boxes in this scene.
        settings: for the confidence threshold, the image border and box noise.

    Raises:
        InsufficientDataError: if there are no confident boxes of registered cameras.
        InvalidInputError: if the localization was made from other boxes.
    """
    confident = detections[is_confident(detections, settings.confidence)]
    if not scene.rig.registered[confident.camera].any():
        raise InsufficientDataError(
            "Checking a rig needs confident boxes of its registered cameras, but there are none. "
            "Check that the detections belong to the scene, and their scores."
        )
    frames = np.unique(confident.frame)
    step = frame_step(frames)
    first = int(frames[0])
    boxes = _boxes(scene, confident, settings.evidence, first, step)
    people, unit = _people(scene, detections, localization, first, step)
    steps = (int(frames[-1]) - first) // step + 1
    return Sights(
        scene, _places(scene), boxes, people, unit, first, step, steps, confident, settings
    )


def with_cameras(sights: Sights, camera: Int[np.ndarray, " n"]) -> Sights:
    """Assign each box to the given camera, leaving the people unchanged."""
    detections = replace(sights.detections, camera=camera)
    boxes = _boxes(sights.scene, detections, sights.settings.evidence, sights.first, sights.step)
    return replace(sights, boxes=boxes, detections=detections)


def _places(scene: Scene) -> Float[np.ndarray, "cam 3 4"]:
    rig, ground = scene.rig, scene.ground
    R, t = (np.asarray(part, np.float64) for part in (rig.R, rig.t))
    basis, normal = (np.asarray(v, np.float64) for v in (ground.basis, ground.normal))
    turn = R @ np.column_stack([basis, normal])
    place = t - R @ (float(ground.offset) * normal)
    joined = np.concatenate([turn, place[..., None]], -1)
    return np.where(rig.registered[:, None, None], joined, np.eye(3, 4))


def _boxes(
    scene: Scene, detections: Detections, settings: EvidenceSettings, first: int, step: int
) -> SightedBoxes:
    rig = scene.rig
    row = np.flatnonzero(rig.registered[detections.camera])
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
    whole = ~cut_by_border(box, rig.image_size[camera], settings.border_margin)
    frame, height = (detections.frame[row] - first) // step, box[:, 3] - box[:, 1]
    tall = angle[:, 2] - angle[:, 1]
    deviation = np.array(settings.edge_noise) * tall[:, None] + FLOOR
    return SightedBoxes(frame, camera, angle, deviation, tall, height, whole)


def _people(
    scene: Scene, detections: Detections, localization: Localization, first: int, step: int
) -> tuple[SightedPeople, float]:
    """Make people of tracks, with the height that their boxes imply."""
    tracks = localization.tracks
    row, _, height = heights_by_boxes(detections, localization, scene)
    row, height = row[height > 0], height[height > 0]
    unit = float(np.median(height)) if len(height) else float(scene.extent) / 12
    track = tracks.track_id
    tall = np.full(len(track), unit)
    for one in np.unique(track[row]):
        tall[track == one] = np.median(height[track[row] == one])
    tall = np.clip(tall, HEIGHTS[0] * unit, HEIGHTS[1] * unit)
    at = np.flatnonzero((track >= 0) & (tracks.frame >= first))
    velocity = np.nan_to_num(np.asarray(tracks.velocity, np.float64)[at]) * step
    state = np.column_stack([np.asarray(tracks.ground_xy, np.float64), tall])[at]
    seen, frame = tracks.support[at] >= 0, (tracks.frame[at] - first) // step
    return SightedPeople(frame, track[at], state, velocity, seen), unit


def predict_angles(
    error: Float[Array, "8"],
    state: Float[Array, "3"],
    velocity: Float[Array, "2"],
    place: Float[Array, "3 4"],
) -> Float[Array, "3"]:
    """Predict the angles of a person's box in a camera.

    Args:
        error: (8,) error of the camera, its turn to first order, its displacement in scene units.
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
    # The axes are orthogonal, but not all of unit length (see `corrected_place`).
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
