"""Evidence on a plane: whether cameras and people say that it is the ground.

Walls, ceilings and tables are planes too, often the largest. What tells the ground from them is not
in the points but in the pictures: cameras above, people upright, feet ahead, a camera height in
people that exists, and feet on which the cameras agree. One plane at a time is judged here; where
planes come from is the matter of `ground`.
"""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from catfree.geometry import intersect_ray
from catfree.methods.paper.association._observe import expand_ranges
from catfree.types import Detections, Plane, Rig
from catfree.types._sampling import evenly_spread

SAMPLED_DETECTIONS = 5_000
FEWEST_DETECTIONS = 10  # fewer say nothing about the vertical

LARGEST_TILT = np.deg2rad(30.0)  # streets slope by 10, boxes of leaning people mislead by 10
LARGEST_CAMERA_TILT = np.deg2rad(50.0)  # without people: cameras that look down steeply
CAMERAS_ABOVE = 0.9  # share of the cameras
FEET_AHEAD = 0.8  # share of the foot rays that meet the ground; some boxes are wrong
CAMERA_HEIGHT = (0.2, 60.0)  # in heights of a person: from a toy tripod to a 100 m tower

_meet = jax.jit(jax.vmap(intersect_ray, (None, 0, 0)))


@dataclass(frozen=True)
class GroundCandidate:
    """A plane of the scene and what the pictures say about it; NaN where nothing was there to say.

    Attributes:
        plane: oriented towards the cameras.
        share: of the scene's points that lie on it.
        cameras_above: share of the cameras on the positive side.
        tilt: angle in radians between its normal and the way up: that of standing people, or of
            the cameras where too few people are known. 90 degrees is a wall, 180 a ceiling.
        feet_ahead: share of the rays through people's feet that meet it ahead of the camera.
        camera_height: median height of the cameras over it in heights of a person on it.
        feet_apart: median distance, in heights of a person, between the place of a foot by one
            camera and the nearest one by another camera in the same frame.
        fault: why it is not the ground, or None.
    """

    plane: Plane
    share: float
    cameras_above: float
    tilt: float
    feet_ahead: float
    camera_height: float
    feet_apart: float
    fault: str | None


@dataclass(frozen=True)
class People:
    """Rays through feet and heads of people's boxes.

    Attributes:
        frame: (N,) frame of each box.
        camera: (N,) its camera.
        center: (N, 3) centre of that camera.
        foot: (N, 3) unit direction through the bottom centre.
        head: (N, 3) unit direction through the top centre.
    """

    frame: np.ndarray
    camera: np.ndarray
    center: np.ndarray
    foot: np.ndarray
    head: np.ndarray


def people_of(rig: Rig, detections: Detections | None) -> People | None:
    """Rays of at most so many boxes in whole frames; None if there are too few to say anything."""
    if detections is None:
        return None
    known = (detections.camera < rig.camera_count) & rig.registered[
        np.minimum(detections.camera, rig.camera_count - 1)
    ]
    frames, counts = np.unique(detections.frame[known], return_counts=True)
    if known.sum() < FEWEST_DETECTIONS:
        return None
    affordable = max(1, int(SAMPLED_DETECTIONS / counts.mean()))
    rows = np.flatnonzero(known & np.isin(detections.frame, evenly_spread(frames, affordable)))
    rows = rows[np.argsort(detections.frame[rows], kind="stable")]
    box, camera = detections.box[rows].astype(np.float64), detections.camera[rows]
    middle = (box[:, 0] + box[:, 2]) / 2
    K, R = np.asarray(rig.K, np.float64)[camera], np.asarray(rig.R, np.float64)[camera]

    def directions(y: np.ndarray) -> np.ndarray:
        # Lens distortion bends these rays by less than the checks below care about.
        pixel = np.column_stack([middle, y, np.ones(len(y))])
        ray = np.einsum("nji,nj->ni", R, np.linalg.solve(K, pixel[..., None])[..., 0])
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True)

    center = np.asarray(rig.centers, np.float64)[camera]
    foot, head = directions(box[:, 3]), directions(box[:, 1])
    return People(detections.frame[rows], camera, center, foot, head)


def way_up(rig: Rig, people: People | None) -> Float[np.ndarray, "3"]:
    """The direction in which people stand, or the cameras where people do not say.

    Foot ray and head ray of a standing person span a plane that holds the vertical, so the vertical
    is perpendicular to the normals of all those planes.
    """
    camera_up = -np.asarray(rig.R, np.float64)[rig.registered][:, 1].mean(axis=0)
    camera_up /= np.linalg.norm(camera_up)
    if people is None:
        return camera_up
    across = np.cross(people.foot, people.head)
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), np.finfo(float).tiny)
    # People who are all seen in one direction leave a circle open: the cameras' up settles it.
    doubt = np.eye(3) - np.outer(camera_up, camera_up)
    scatter = np.einsum("ni,nj->ij", across, across) / len(across) + 0.01 * doubt
    up = np.linalg.eigh(scatter)[1][:, 0]
    rising = np.median((people.head - people.foot) @ up)
    return up if rising > 0 else -up


def judge(
    plane: Plane, share: float, centers: np.ndarray, people: People | None, up: np.ndarray
) -> GroundCandidate:
    """What the cameras and the people say about a plane."""
    height = plane.signed_distance(centers)
    above = float((height > 0).mean())
    tilt = float(np.arccos(np.clip(plane.normal @ up, -1.0, 1.0)))
    ahead = camera_height = apart = np.nan
    if people is not None:
        ahead, camera_height, apart = _measure(plane, people)
    fault = None
    if above < CAMERAS_ABOVE:
        fault = f"only {100 * above:.0f} % of the cameras are on one side of it"
    elif tilt > (LARGEST_CAMERA_TILT if people is None else LARGEST_TILT):
        whose = "the cameras' upright direction" if people is None else "the way people stand"
        kind = "a ceiling" if tilt > np.pi - LARGEST_CAMERA_TILT else "a wall"
        fault = f"{kind}, its normal is {np.rad2deg(tilt):.0f} degrees from {whose}"
    elif ahead < FEET_AHEAD:
        fault = f"only {100 * ahead:.0f} % of the rays through people's feet meet it"
    elif not (np.isnan(camera_height) or CAMERA_HEIGHT[0] <= camera_height <= CAMERA_HEIGHT[1]):
        fault = f"the cameras would stand {camera_height:.3g} heights of a person above it"
    return GroundCandidate(plane, share, above, tilt, ahead, camera_height, apart, fault)


def _measure(plane: Plane, people: People) -> tuple[float, float, float]:
    """Share of feet ahead, camera height and distance between cameras' feet, in people."""
    height = plane.signed_distance(people.center)
    with jax.enable_x64(True):
        foot, ahead = map(np.asarray, _meet(plane, people.center, people.foot))
    meets = ahead & (height > 0)
    share = float(meets.mean())
    if not meets.any():
        return share, np.nan, np.nan
    foot = foot[meets]
    # The point of the vertical through the foot that is closest to the head ray.
    to_center = people.center[meets] - foot
    head = people.head[meets]
    cosine = head @ plane.normal
    sine2 = np.maximum(1 - cosine**2, 1e-6)
    across = np.einsum("ni,ni->n", to_center, head)
    tall = (to_center @ plane.normal - across * cosine) / sine2
    person = float(np.median(tall))
    if person <= 0:
        return share, np.nan, np.nan
    camera_height = float(np.median(height[meets])) / person
    return share, camera_height, _feet_apart(people, meets, foot) / person


def _feet_apart(people: People, meets: np.ndarray, foot: np.ndarray) -> float:
    """Median distance to the nearest foot that another camera sees in the same frame."""
    frame, camera = people.frame[meets], people.camera[meets]
    start = np.searchsorted(frame, frame, side="left")
    stop = np.searchsorted(frame, frame, side="right")
    first, second = expand_ranges(start, stop)
    other = camera[first] != camera[second]
    first, second = first[other], second[other]
    distance = np.linalg.norm(foot[first] - foot[second], axis=-1)
    nearest = np.full(len(foot), np.inf)
    np.minimum.at(nearest, first, distance)
    known = np.isfinite(nearest)
    return float(np.median(nearest[known])) if known.any() else np.nan
