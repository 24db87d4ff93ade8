"""Position errors of people who do not stand exactly on the ground plane.

Cameras on one side of a person share the error: a foot z above the plane shifts their positions
along similar rays by z times distance over camera height. With cameras on all sides, the shifts
cancel. With edges linear in the state s and in z, edges = J s + j z + noise, the estimate moves by

    ds / dz = (J'W J + prior)^-1 J'W j

and both sums add over cameras. A smoothed position depends on its neighbors in time, so the median
shift around it is used; a single chance match with another camera must not determine it.
"""

import numpy as np
from jaxtyping import Float

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.observe._sightings import sightings_by_camera
from catfree.methods.evidence.track._tracking import Trails
from catfree.settings import EvidenceSettings


def ground_shift(
    trails: Trails, state: EvidenceState, settings: EvidenceSettings
) -> Float[np.ndarray, "node 2"]:
    """Shift of each position, from its own boxes, per unit of height of the feet above the plane.

    Args:
        trails: the tracks.
        state: the groups of the tracks and their boxes.
        settings: without `uneven_ground` nobody stands above the plane.

    Returns:
        (M, 2) meters per meter, 0 in gaps.
    """
    M, member = len(trails), state.groups.member
    if len(member) == 0 or not settings.uneven_ground:
        return np.zeros((M, 2))
    member = np.where(trails.group[:, None] >= 0, member[trails.group], -1)
    normal, cross = np.zeros((M, 3, 3)), np.zeros((M, 3))
    boxes = state.measurements, state.boxes.view, state.views
    for sightings in sightings_by_camera(trails.mean[:, :3], member, *boxes):
        slopes = sightings.slopes * sightings.precision[..., None]
        normal[sightings.person] += np.einsum("nki,nkj->nij", slopes[..., :3], slopes[..., :3])
        cross[sightings.person] += np.einsum("nki,nk->ni", slopes[..., :3], slopes[..., 3])
    normal[:, 2, 2] += 1 / float(state.noise.spread) ** 2
    scale = np.trace(normal, axis1=1, axis2=2)[:, None, None]
    return np.linalg.solve(normal + 1e-9 * scale * np.eye(3), cross[..., None])[:, :2, 0]


def usual_shift(
    trails: Trails, shift: Float[np.ndarray, "node 2"], reach: int
) -> Float[np.ndarray, "node 2"]:
    """Median (by length) of the shifts of the rows around each row of a track.

    Args:
        trails: the tracks; each row has at least one row with boxes within reach.
        shift: (M, 2) result of `ground_shift`.
        reach: number of frames on either side to consider.
    """
    M = len(trails)
    length = np.where(trails.group >= 0, np.linalg.norm(shift, axis=1), np.nan)
    # Rows of a track are consecutive frames.
    window = np.arange(M)[:, None] + np.arange(-reach, reach + 1)
    inside = (window >= 0) & (window < M)
    window = np.clip(window, 0, M - 1)
    inside &= trails.track[window] == trails.track[:, None]
    around = np.where(inside, length[window], np.nan)
    middle = (np.isfinite(around).sum(1, keepdims=True) - 1) // 2
    chosen = np.take_along_axis(np.argsort(around, axis=1), np.maximum(middle, 0), axis=1)
    return shift[np.take_along_axis(window, chosen, axis=1)[:, 0]]
