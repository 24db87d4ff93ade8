"""Groups of boxes that show one person in one frame, and priors from tracks."""

from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float, Int

from catfree.methods.evidence._gaussian import Information, log_evidence
from catfree.methods.evidence.observe._measurement import Noise

VAGUE = 1e-6  # per H0²: a standard deviation of a kilometer, in effect no prior


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Groups:
    """Groups of boxes that show one person in one frame.

    Attributes:
        frame: (H,) frame index.
        member: (H, C) row of `Boxes`, or -1.
        info: (H) information of the boxes alone, without priors.
        gain: (H,) log evidence for one person minus that for one person per box, without
            appearance.
    """

    frame: Int[np.ndarray, " group"]
    member: Int[np.ndarray, "group cam"]
    info: Information
    gain: np.ndarray

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def seeing_cameras(self) -> int:
        """Number of cameras that see anybody."""
        return int((self.member >= 0).any(0).sum())


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Priors:
    """Predicted positions of tracked people, one row per track and frame.

    Attributes:
        frame: (T,) frame index.
        info: (T) without the height prior. Its log evidence alone is 0; joined with boxes, it
            replaces the density of people.
    """

    frame: Int[np.ndarray, " prior"]
    info: Information

    def between(self, begin: int, end: int) -> "Priors":
        """Select the frames from `begin` up to, but not including, `end`."""
        rows = (self.frame >= begin) & (self.frame < end)
        return Priors(self.frame[rows], self.info[rows])


def no_groups(cameras: int) -> Groups:
    """Return an empty set of groups for a number of cameras."""
    info = Information(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0))
    rows = np.zeros(0, np.int64)
    return Groups(rows, np.zeros((0, cameras), np.int64), info, np.zeros(0))


def priors_of(
    frame: Int[np.ndarray, " prior"],
    precision: Float[np.ndarray, "prior 3 3"],
    vector: Float[np.ndarray, "prior 3"],
    noise: Noise,
) -> Priors:
    """Make priors of people; where only rounding errors are known, they are vague.

    Args:
        frame: (T,) frame index.
        precision: (T, 3, 3) inverse covariance of position and height.
        vector: (T, 3) precision times mean.
        noise: for the density of people and the spread of their heights.
    """
    density, spread = float(noise.density), float(noise.spread)
    values, axes = np.linalg.eigh(precision)
    matrix = np.einsum("nij,nj,nkj->nik", axes, np.maximum(values, VAGUE), axes)
    height = np.array([0.0, 0.0, 1 / spread**2])
    info = Information(matrix - np.diag(height), vector - height, np.zeros(len(vector)))
    return Priors(frame, replace(info, constant=2 * log_evidence(info, density, spread)))
