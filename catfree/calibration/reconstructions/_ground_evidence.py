"""Judgment, from cameras and people, of whether a plane is the ground.

Walls, ceilings and tables are planes too, often the largest. The images distinguish the ground: the
cameras are above it at a plausible height relative to people, people stand upright on it, their
feet are in front of the cameras, and the cameras agree on the positions of feet.
"""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from catfree.geometry import intersect_ray
from catfree.geometry._person import implied_height
from catfree.geometry.camera import rays_of_pixels
from catfree.types import Detections, Plane, Rig
from catfree.types._sampling import equal_pairs, evenly_spread

SAMPLED_DETECTIONS = 5_000
FEWEST_DETECTIONS = 10  # fewer do not determine the vertical

LARGEST_TILT = np.deg2rad(30.0)  # streets slope by 10 degrees; boxes of leaning people add 10
LARGEST_CAMERA_TILT = np.deg2rad(50.0)  # without people; cameras may look steeply down
CAMERAS_ABOVE = 0.9  # fraction of the cameras
FEET_AHEAD = 0.8  # fraction of the foot rays that meet the ground; some boxes are wrong
CAMERA_HEIGHT = (0.2, 60.0)  # in person heights: from a toy tripod to a 100 m tower

_meet = jax.jit(jax.vmap(intersect_ray, (None, 0, 0)))
_heights = jax.jit(jax.vmap(implied_height, (0, 0, 0, None, None)))


@dataclass(frozen=True)
class GroundCandidate:
    """A plane of the scene, and the images' evidence about it; NaN if there is none.

    Attributes:
        plane: the plane, oriented toward the cameras.
        share: fraction of the scene's points that lie on it.
        cameras_above: fraction of the cameras on the positive side.
        tilt: angle in radians between its normal and the upward direction of standing people, or
            of the cameras if there are too few people. 90 degrees is a wall, 180 a ceiling.
        feet_ahead: fraction of the rays through people's feet that meet it in front of the camera.
        camera_height: median height of the cameras above it, in person heights.
        feet_apart: median distance, in person heights, between a foot position from one camera and
            the nearest one from another camera in the same frame.
        fault: why the plane is not the ground, or None.
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
class BodyRays:
    """Rays through the feet and heads of people's boxes.

    Attributes:
        frame: (N,) frame of each box.
        camera: (N,) camera of each box.
        center: (N, 3) center of that camera.
        foot: (N, 3) unit direction through the bottom center.
        head: (N, 3) unit direction through the top center.
    """

    frame: np.ndarray
    camera: np.ndarray
    center: np.ndarray
    foot: np.ndarray
    head: np.ndarray


def people_of(rig: Rig, detections: Detections | None) -> BodyRays | None:
    """Cast rays of a sample of boxes in whole frames; None if there are too few boxes."""
    if detections is None:
        return None
    known = np.isin(detections.camera, np.flatnonzero(rig.registered))
    frames, counts = np.unique(detections.frame[known], return_counts=True)
    if known.sum() < FEWEST_DETECTIONS:
        return None
    affordable = max(1, int(SAMPLED_DETECTIONS / counts.mean()))
    rows = np.flatnonzero(known & np.isin(detections.frame, evenly_spread(frames, affordable)))
    rows = rows[np.argsort(detections.frame[rows], kind="stable")]
    box, camera = detections.box[rows].astype(np.float64), detections.camera[rows]
    middle = (box[:, 0] + box[:, 2]) / 2
    center = np.asarray(rig.centers, np.float64)[camera]
    foot, head = (
        rays_of_pixels(rig, camera, np.column_stack([middle, box[:, edge]])) for edge in (3, 1)
    )
    return BodyRays(detections.frame[rows], camera, center, foot, head)


def way_up(rig: Rig, people: BodyRays | None) -> Float[np.ndarray, "3"]:
    """Estimate the upward direction from standing people, or from the cameras without people.

    The foot ray and head ray of a standing person span a plane that contains the vertical, so the
    vertical is perpendicular to the normals of all these planes.
    """
    camera_up = -np.asarray(rig.R, np.float64)[rig.registered][:, 1].mean(axis=0)
    camera_up /= np.linalg.norm(camera_up)
    if people is None:
        return camera_up
    across = np.cross(people.foot, people.head)
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), np.finfo(float).tiny)
    # If all people are in one direction, a circle of solutions remains, which the cameras resolve.
    doubt = np.eye(3) - np.outer(camera_up, camera_up)
    scatter = np.einsum("ni,nj->ij", across, across) / len(across) + 0.01 * doubt
    up = np.linalg.eigh(scatter)[1][:, 0]
    rising = np.median((people.head - people.foot) @ up)
    return up if rising > 0 else -up


def judge_plane(
    plane: Plane, share: float, centers: np.ndarray, people: BodyRays | None, up: np.ndarray
) -> GroundCandidate:
    """Judge a plane from the cameras and the people."""
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
        whose = "cameras'" if people is None else "people's"
        kind = "a ceiling" if tilt > np.pi - LARGEST_CAMERA_TILT else "a wall"
        degrees = f"{np.rad2deg(tilt):.0f} degrees"
        fault = f"{kind}, its normal is {degrees} from the {whose} upright direction"
    elif ahead < FEET_AHEAD:
        fault = f"only {100 * ahead:.0f} % of the rays through people's feet meet it"
    elif not (np.isnan(camera_height) or CAMERA_HEIGHT[0] <= camera_height <= CAMERA_HEIGHT[1]):
        fault = f"the cameras would be {camera_height:.3g} person heights above it"
    return GroundCandidate(plane, share, above, tilt, ahead, camera_height, apart, fault)


def _measure(plane: Plane, people: BodyRays) -> tuple[float, float, float]:
    """Fraction of feet ahead, camera height and foot disagreement, in person heights."""
    height = plane.signed_distance(people.center)
    with jax.enable_x64(True):
        foot, ahead = _meet(plane, people.center, people.foot)
        tall = _heights(people.center, people.head, foot, plane.normal, plane.offset)
    foot, ahead, tall = map(np.asarray, (foot, ahead, tall))
    meets = ahead & (height > 0)
    share = float(meets.mean())
    if not meets.any():
        return share, np.nan, np.nan
    foot = foot[meets]
    person = float(np.median(tall[meets]))
    if person <= 0:
        return share, np.nan, np.nan
    camera_height = float(np.median(height[meets])) / person
    return share, camera_height, _feet_apart(people, meets, foot) / person


def _feet_apart(people: BodyRays, meets: np.ndarray, foot: np.ndarray) -> float:
    """Median distance to the nearest foot of another camera in the same frame."""
    frame, camera = people.frame[meets], people.camera[meets]
    first, second = equal_pairs(frame, frame)
    other = camera[first] != camera[second]
    first, second = first[other], second[other]
    distance = np.linalg.norm(foot[first] - foot[second], axis=-1)
    nearest = np.full(len(foot), np.inf)
    np.minimum.at(nearest, first, distance)
    known = np.isfinite(nearest)
    return float(np.median(nearest[known])) if known.any() else np.nan
