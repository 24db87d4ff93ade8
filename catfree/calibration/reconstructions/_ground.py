"""Search for the ground among the planes of a scene, such as walls, ceilings and tables."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from catfree.calibration.reconstructions._ground_evidence import (
    GroundCandidate,
    judge_plane,
    people_of,
    way_up,
)
from catfree.errors import DegenerateGeometryError, GroundRejectedError, InsufficientDataError
from catfree.geometry import fit_plane_ransac
from catfree.geometry._buckets import padded, padded_length
from catfree.types import Detections, Plane, Rig
from catfree.types._annotations import HostOrDevice
from catfree.types._sampling import evenly_spread

INLIER_SHARE = 0.01  # fraction of E: the paper's tolerance of a ray (delta)
REMOVED_SHARE = 3.0  # tolerances around a rejected plane within which points are removed
CANDIDATES = 8  # planes to try: floor, ceiling, four walls and two more
FEWEST_POINTS = 30  # smaller planes are chance
SMALLEST_SHARE = 0.005  # of all points; likewise
SAMPLED_POINTS = 20_000  # larger clouds are evenly sampled
CONFIDENT = 0.5  # points below this fraction of the median confidence are ignored
ITERATIONS = 1024  # random triples: a plane with 15 % of the points is missed once in 30 runs


@dataclass(frozen=True)
class Ground:
    """The ground of a scene and the evidence for and against all planes.

    Attributes:
        plane: the ground, with the cameras on its positive side.
        inliers: (P,) whether the point lies on the ground.
        candidates: all planes tried, in order of decreasing support.
    """

    plane: Plane
    inliers: Bool[np.ndarray, " p"]
    candidates: tuple[GroundCandidate, ...]


def find_ground(
    points: Float[HostOrDevice, "p 3"],
    rig: Rig,
    detections: Detections | None = None,
    *,
    confidence: Float[HostOrDevice, " p"] | None = None,
    threshold: float | None = None,
    seed: int = 0,
) -> Ground:
    """Find the plane that people stand on.

    Planes are extracted from the points one by one, the largest first. The cameras must be above
    the ground at a plausible height relative to the people, and people must be upright on it with
    their feet in front of the cameras. Of the planes that pass, the ground is the one on which the
    cameras agree best about the positions of feet, or the largest if there are no people.

    Args:
        points: (P, 3) scene points in the rig's frame; non-finite rows are ignored.
        rig: the cameras.
        detections: boxes of people.
        confidence: (P,) confidence of each point; points of low confidence are ignored.
        threshold: inlier distance in scene units; 1 % of the rig's extent if None.
        seed: seed of the random search.

    Returns:
        The ground, fitted to its inliers, and the evidence on all planes tried.

    Raises:
        InsufficientDataError: if there are fewer than three points or no registered camera.
        GroundRejectedError: if no plane can be the ground, with the reason for each, or all points
            lie on a line.

    Source:
        Sec. "Camera configuration and ground estimation" of the paper.
    """
    cloud = np.asarray(points, np.float64)
    usable = np.asarray(np.isfinite(cloud).all(axis=1))
    if confidence is not None and usable.any():
        point_confidence = np.asarray(confidence, np.float64)
        usable &= point_confidence >= CONFIDENT * np.median(point_confidence[usable])
    centers = np.asarray(rig.centers, np.float64)[rig.registered]
    if usable.sum() < 3 or len(centers) == 0:
        raise InsufficientDataError(
            f"A ground needs at least 3 scene points and a registered camera, got "
            f"{int(usable.sum())} points and {len(centers)} cameras."
        )
    # With the scene centered and scaled to size one, float32 is exact enough.
    middle = centers.mean(axis=0)
    extent = 2 * float(np.median(np.linalg.norm(centers - middle, axis=-1)))
    if extent == 0:
        extent = float(np.median(np.linalg.norm(cloud[usable] - middle, axis=-1)))
    tolerance = INLIER_SHARE if threshold is None else threshold / extent
    local = np.where(usable[:, None], (cloud - middle) / extent, np.nan)
    sample = evenly_spread(np.flatnonzero(usable), SAMPLED_POINTS)
    people = people_of(rig, detections)
    up = way_up(rig, people)

    candidates: list[GroundCandidate] = []
    remaining = local[sample]
    fewest = max(FEWEST_POINTS, SMALLEST_SHARE * len(sample))
    for key in jax.random.split(jax.random.key(seed), CANDIDATES):
        try:
            largest = _largest_plane(remaining, key, tolerance)
        except DegenerateGeometryError as error:
            if candidates:
                break
            raise GroundRejectedError(
                f"No plane can be the ground: the {int(usable.sum())} scene points coincide or lie "
                "on one line; choose instants that show more of the floor, or pass a Scene with a "
                "known ground."
            ) from error
        distance = np.abs(np.asarray(largest.signed_distance(remaining)))
        share = float((distance <= tolerance).sum()) / len(sample)
        if len(candidates) and share * len(sample) < fewest:
            break
        plane = Plane(largest.normal, extent * largest.offset - largest.normal @ middle)
        candidates.append(judge_plane(plane, share, centers, people, up))
        remaining = remaining[distance > REMOVED_SHARE * tolerance]
        if len(remaining) < fewest:
            break
    good = [candidate for candidate in candidates if candidate.fault is None]
    if not good:
        reasons = "; ".join(
            f"plane {i + 1} ({100 * candidate.share:.0f} % of the points): {candidate.fault}"
            for i, candidate in enumerate(candidates)
        )
        raise GroundRejectedError(
            f"None of {len(candidates)} planes among {int(usable.sum())} scene points can be the "
            f"ground ({reasons}); choose instants that show more of the floor, or pass a Scene "
            "with a known ground."
        )
    # `min` is stable: among planes without information on feet, it selects the first and largest.
    best = min(good, key=lambda c: c.feet_apart if np.isfinite(c.feet_apart) else np.inf)
    distance = np.abs(best.plane.signed_distance(np.where(usable[:, None], cloud, 0.0)))
    inliers = usable & (distance <= tolerance * extent)
    return Ground(best.plane, inliers, tuple(candidates))


def _largest_plane(points: np.ndarray, key: jax.Array, tolerance: float) -> Plane:
    """Find the plane with most support, oriented toward the origin (the mean of the cameras)."""
    length, dtype = padded_length(len(points), 64, 2), jnp.result_type(float)
    fit = fit_plane_ransac(
        padded(points.astype(dtype), length),
        key,
        threshold=np.asarray(tolerance, dtype),
        iterations=ITERATIONS,
        where=np.arange(length) < len(points),
        toward=np.zeros(3, dtype),
    )
    normal = np.asarray(fit.plane.normal, np.float64)
    return Plane(normal, np.asarray(fit.plane.offset, np.float64))
