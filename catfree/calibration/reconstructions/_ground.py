"""The ground among the planes of a scene: walls, ceilings and tables have to be told from it."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from catfree.calibration.reconstructions._ground_evidence import (
    GroundCandidate,
    judge,
    people_of,
    way_up,
)
from catfree.errors import GroundRejectedError, InsufficientDataError
from catfree.geometry import fit_plane_ransac
from catfree.types import Detections, Plane, Rig
from catfree.types._array_types import HostOrDevice
from catfree.types._sampling import evenly_spread

INLIER_SHARE = 0.01  # of E: the tolerance that the paper grants a ray (delta)
REMOVED_SHARE = 3.0  # points within so many tolerances go with a rejected plane: its rough border
CANDIDATES = 8  # planes that are tried: floor, ceiling, four walls and two more
FEWEST_POINTS = 30  # a plane on fewer points, or on fewer than the next share of all, is chance
SMALLEST_SHARE = 0.005
SAMPLED_POINTS = 20_000  # of a larger cloud, evenly
CONFIDENT = 0.5  # points below this share of the median confidence are left out
ITERATIONS = 1024  # random triples: a plane on 15 % of the points is missed once in 30 times


@dataclass(frozen=True)
class Ground:
    """The ground of a scene and how it was told from other planes.

    Attributes:
        plane: the ground, cameras on the positive side.
        inliers: (P,) points that lie on it.
        candidates: all planes that were tried, in the order of their support.
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
    """The plane that people stand on.

    Planes are taken from the points one after the other, the largest first. Each must have the
    cameras above it, people upright on it, their feet in front of the cameras, and the cameras at a
    height that fits the people's. Among those that pass, the one on which the cameras agree best
    about where the feet are is the ground; without people, the largest.

    Args:
        points: (P, 3) scene points in the rig's frame; rows that are not finite are left out.
        rig: the cameras.
        detections: boxes of people.
        confidence: (P,) confidence of each point; the doubtful ones are left out.
        threshold: distance of an inlier in scene units; None for a hundredth of the rig's extent.
        seed: of the random search.

    Returns:
        The ground, fitted to its inliers, with the evidence on all planes tried.

    Raises:
        InsufficientDataError: if there are fewer than three points or no registered camera.
        GroundRejectedError: if no plane can be the ground, with the reason for each.

    Source:
        Sec. "Camera configuration and ground estimation" of the paper.
    """
    cloud = np.asarray(points, np.float64)
    usable = np.asarray(np.isfinite(cloud).all(axis=1))
    if confidence is not None and usable.any():
        sure = np.asarray(confidence, np.float64)
        usable &= sure >= CONFIDENT * np.median(sure[usable])
    centers = np.asarray(rig.centers, np.float64)[rig.registered]
    if usable.sum() < 3 or len(centers) == 0:
        raise InsufficientDataError(
            f"A ground needs at least 3 scene points and a registered camera, got "
            f"{int(usable.sum())} points and {len(centers)} cameras."
        )
    # Near the origin and of size one, float32 is exact enough for any scene.
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
    left = local[sample]
    fewest = max(FEWEST_POINTS, SMALLEST_SHARE * len(sample))
    for key in jax.random.split(jax.random.key(seed), CANDIDATES):
        found = _largest_plane(left, key, tolerance)
        distance = np.abs(np.asarray(found.signed_distance(left)))
        share = float((distance <= tolerance).sum()) / len(sample)
        if len(candidates) and share * len(sample) < fewest:
            break
        plane = Plane(found.normal, extent * found.offset - found.normal @ middle)
        candidates.append(judge(plane, share, centers, people, up))
        left = left[distance > REMOVED_SHARE * tolerance]
        if len(left) < fewest:
            break
    good = [candidate for candidate in candidates if candidate.fault is None]
    if not good:
        seen = "; ".join(
            f"plane {i + 1} ({100 * candidate.share:.0f} % of the points): {candidate.fault}"
            for i, candidate in enumerate(candidates)
        )
        raise GroundRejectedError(
            f"None of {len(candidates)} planes among {int(usable.sum())} scene points can be the "
            f"ground. {seen}. Choose instants that show more of the floor, or pass a Scene with a "
            "known ground."
        )
    # Stable: the first of those that say nothing about feet is the largest.
    best = min(good, key=lambda c: c.feet_apart if np.isfinite(c.feet_apart) else np.inf)
    distance = np.abs(best.plane.signed_distance(np.where(usable[:, None], cloud, 0.0)))
    inliers = usable & (distance <= tolerance * extent)
    return Ground(best.plane, inliers, tuple(candidates))


def _largest_plane(points: np.ndarray, key: jax.Array, tolerance: float) -> Plane:
    """The plane with most support, oriented towards the origin (the middle of the cameras)."""
    # Padded to a power of two, so that shrinking clouds share a compiled function.
    length = 1 << max(int(np.ceil(np.log2(len(points)))), 6)
    dtype = jnp.result_type(float)
    padded = np.zeros((length, 3), dtype)
    padded[: len(points)] = points
    fit = fit_plane_ransac(
        padded,
        key,
        threshold=np.asarray(tolerance, dtype),
        iterations=ITERATIONS,
        where=np.arange(length) < len(points),
        toward=np.zeros(3, dtype),
    )
    normal = np.asarray(fit.plane.normal, np.float64)
    return Plane(normal, np.asarray(fit.plane.offset, np.float64))
