"""Boxes that are one person in one frame, and tracks that expect one."""

import equinox as eqx
import numpy as np
from jaxtyping import Int

from catfree.methods.evidence._gaussian import Information, log_evidence


class Groups(eqx.Module):
    """Boxes that are one person in one frame.

    Attributes:
        frame: (H,) frame index.
        member: (H, C) row of `Boxes` or -1.
        prior: (H,) row of the track prior that joined, among the rows behind the boxes, or -1.
        info: (H) information of the boxes alone, without priors.
        full: (H) the same with the track prior.
        gain: (H,) log evidence of one person over that of as many separate ones, appearance aside.
    """

    frame: Int[np.ndarray, " group"]
    member: Int[np.ndarray, "group cam"]
    prior: Int[np.ndarray, " group"]
    info: Information
    full: Information
    gain: np.ndarray

    def __len__(self) -> int:
        return len(self.frame)


class Priors(eqx.Module):
    """Where tracks expect their people: one row a track and frame.

    Attributes:
        frame: (T,) frame index.
        mean: (T, 3) position and height.
        covariance: (T, 3, 3).
    """

    frame: Int[np.ndarray, " prior"]
    mean: np.ndarray
    covariance: np.ndarray


def prior_information(priors: Priors, density: float, spread: float) -> Information:
    """Track priors as items: alone their log evidence is 0, joined they replace the density."""
    full = np.linalg.inv(priors.covariance)
    vector = np.einsum("nij,nj->ni", full, priors.mean)
    matrix = full.copy()
    matrix[:, 2, 2] -= 1 / spread**2
    shifted = vector.copy()
    shifted[:, 2] -= 1 / spread**2
    info = Information(matrix, shifted, np.zeros(len(vector)))
    alone = log_evidence(info, density, spread)
    return Information(matrix, shifted, 2 * alone)


def collect_groups(
    root: Int[np.ndarray, " item"],
    items: Int[np.ndarray, " n"],
    info: Information,
    frame: Int[np.ndarray, " item"],
    camera: Int[np.ndarray, " item"],
    cameras: int,
    density: float,
    spread: float,
) -> Groups:
    """Groups from their representatives, summed again from their members.

    Args:
        root: (N,) the item that represents each item's group.
        items: (n,) the items that take part.
        info: (N) information of each item.
        frame: (N,) frame index.
        camera: (N,) camera index, C for a track prior.
        cameras: C.
        density: people per H0².
        spread: of heights in H0.

    Returns:
        Groups with at least one box, in the order of their representatives.
    """
    boxes = items[camera[items] < cameras]
    heads, index = np.unique(root[items], return_inverse=True)
    # Tracks whose person nobody saw leave no group.
    seen = np.bincount(index, camera[items] < cameras, len(heads)) > 0
    index = (np.cumsum(seen) - 1)[index]
    keep = seen[np.searchsorted(heads, root[items])]
    items, index = items[keep], index[keep]
    heads = heads[seen]
    H = len(heads)
    member = np.full((H, cameras), -1)
    prior = np.full(H, -1)
    of = np.full(len(root), -1)
    of[items] = index
    member[of[boxes], camera[boxes]] = boxes
    tracks = items[camera[items] == cameras]
    prior[of[tracks]] = tracks
    own = _sum(info, member)
    with_prior = Information(*(x.copy() for x in (own.matrix, own.vector, own.constant)))
    has = prior >= 0
    with_prior.matrix[has] += info.matrix[prior[has]]
    with_prior.vector[has] += info.vector[prior[has]]
    with_prior.constant[has] += info.constant[prior[has]]
    single = np.zeros(len(root))
    single[items] = log_evidence(info[items], density, spread)
    alone = np.where(member >= 0, single[np.maximum(member, 0)], 0.0).sum(1)
    gain = log_evidence(own, density, spread) - alone
    return Groups(frame[heads], member, prior, own, with_prior, gain)


def _sum(info: Information, member: np.ndarray) -> Information:
    there = member >= 0
    rows = np.maximum(member, 0)
    return Information(
        np.where(there[..., None, None], info.matrix[rows], 0.0).sum(1),
        np.where(there[..., None], info.vector[rows], 0.0).sum(1),
        np.where(there, info.constant[rows], 0.0).sum(1),
    )
