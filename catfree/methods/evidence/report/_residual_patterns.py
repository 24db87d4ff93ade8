"""Patterns in the residuals of each camera that no noise of boxes leaves.

A late clock leaves residuals along the way that people walk, and a camera that was moved different
residuals before and after. A rig that fits people in spite of such a pattern may be far off. For
what a wrong lens leaves, see `_lens_pattern`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from catfree.geometry._arrays import MEDIAN_TO_DEVIATION
from catfree.geometry._buckets import fine_length
from catfree.geometry._person import edges_and_slopes
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._measurement import Measurements
from catfree.methods.evidence.observe._views import GroundViews
from catfree.methods.evidence.track._tracking import Trails
from catfree.types._annotations import HostOrDevice
from catfree.types._validation import shown_camera

# Columns of a late clock, and of a move (across, down); the first three are constant offsets.
_GROUPS = (slice(3, 4), slice(4, 6))
LARGEST = 4.0  # usual residuals of the camera, to which residuals are clipped
BLOCK = 12  # frames of a track whose errors count as one
LARGEST_SHARE = 0.15  # of the variance; simulated and real rigs in order reach 0.03
LEAST_TOGETHER = 0.6  # cameras that miss people each on its own are seldom below 0.95
FEWEST_TOGETHER = 20  # expected sightings by two cameras, to judge them


class Explained(NamedTuple):
    """What patterns explain of the residuals of one camera.

    Attributes:
        share: (2,) share of the variance that the clock and a move in the middle explain beyond
            what they reach by chance; negative if less.
        coefficient: (3,) of the clock (usual steps by which the camera is late), and of the move
            (pixels across and down).
        variance: () mean square of the standardized residuals without constant offsets.
    """

    share: Float[HostOrDevice, "*cam 2"]
    coefficient: Float[HostOrDevice, "*cam 3"]
    variance: Float[HostOrDevice, "*cam"]


def explained(
    residual: Float[Array, "n 3"],
    columns: Float[Array, "n 3 6"],
    block: Int[Array, " n"],
) -> Explained:
    """Fit patterns to the residuals of one camera.

    The share by chance follows from the scatter of the blocks: the errors of a person in successive
    frames are alike.

    Args:
        residual: (n, 3) standardized residuals of the edges.
        columns: (n, 3, 6) what each pattern adds: an offset of each coordinate in pixels, and the
            columns of `_GROUPS`; all 0 where there is no residual.
        block: (n,) which rows count as one, below n.

    Source:
        Liang and Zeger, "Longitudinal data analysis using generalized linear models" (1986), for
        the variance of sums over blocks.
    """
    present = jnp.any(columns != 0, axis=-1)
    size = jnp.where(present, jnp.abs(residual), jnp.nan)
    usual = jnp.nan_to_num(MEDIAN_TO_DEVIATION * jnp.nanmedian(size))
    r = jnp.where(present, jnp.clip(residual, -LARGEST * usual, LARGEST * usual), 0.0)
    scale = jnp.sqrt(jnp.maximum((columns**2).sum((0, 1)), 1e-30))
    X = columns / scale[None, None]
    normal = jnp.einsum("nka,nkb->ab", X, X)
    inverse = jnp.linalg.inv(normal + 1e-6 * jnp.eye(len(scale), dtype=X.dtype))
    beta = inverse @ jnp.einsum("nka,nk->a", X, r)
    left = r - X @ beta
    score = jax.ops.segment_sum(jnp.einsum("nka,nk->na", X, left), block, len(r))
    spread = inverse @ (score.T @ score) @ inverse
    constant = normal[:3, :3] + 1e-6 * jnp.eye(3, dtype=X.dtype)
    offset = jnp.linalg.solve(constant, jnp.einsum("nka,nk->a", X[..., :3], r))
    plain = r - X[..., :3] @ offset
    total = jnp.maximum((plain**2).sum(), 1e-12)
    shares = []
    for group in _GROUPS:
        weight = jnp.linalg.inv(inverse[group, group])
        saved = beta[group] @ weight @ beta[group]
        shares.append((saved - jnp.trace(weight @ spread[group, group])) / total)
    count = jnp.maximum(present.sum(), 1).astype(total.dtype)
    return Explained(jnp.stack(shares), (beta / scale)[3:], total / count)


class Patterns(NamedTuple):
    """What patterns explain in each camera.

    Attributes:
        explained: of each camera, see `Explained`.
        together: (C, C) of the faster half of the people, `seen_together`: people who stand say
            nothing of clocks.
    """

    explained: Explained
    together: Float[np.ndarray, "cam cam"]

    @property
    def largest_share(self) -> float:
        """Largest share of the variance of a camera's residuals that a pattern explains."""
        return float(np.max(self.explained.share, initial=0.0))

    @property
    def least_together(self) -> float:
        """Smallest entry of `together`; NaN if there is none."""
        known = self.together[np.isfinite(self.together)]
        return float(known.min()) if len(known) else float("nan")

    def sentences(self, camera_names: Sequence[str] | None = None) -> tuple[str, ...]:
        """Name the cameras whose pattern cannot be overlooked."""
        said = []
        shares, coefficients = self.explained.share, self.explained.coefficient
        for camera, kind in np.argwhere(np.asarray(shares) > LARGEST_SHARE).tolist():
            name = shown_camera(camera, camera_names)
            late = -float(coefficients[camera, 0])
            moved = float(np.hypot(*coefficients[camera, 1:]))
            said.append(
                (
                    f"The boxes of camera {name} are {'behind' if late > 0 else 'ahead of'} "
                    f"the people by {abs(late):.1f} frames: correct its clock.",
                    f"Camera {name} shows people {2 * moved:.0f} pixels apart in the two halves "
                    "of the recording: it was moved; calibrate the halves apart.",
                )[kind]
            )
        low = np.triu(np.nan_to_num(self.together, nan=np.inf) < LEAST_TOGETHER)
        for pair in np.argwhere(low).tolist():
            one, other = (shown_camera(camera, camera_names) for camera in pair)
            said.append(
                f"Cameras {one} and {other} hardly ever see the same person at the same time, "
                "though both should: a clock or a pose is wrong, and people count twice."
            )
        return tuple(said)


@jax.jit
def _explained(state, velocity, half, block, member, edges, noise, used, view, matrix):
    """`Explained` of all cameras."""

    def one(state, velocity, half, row):
        at = jnp.maximum(row, 0)
        predicted, slopes = edges_and_slopes(matrix[view[at]], None, state)
        weight = jnp.where((row >= 0) & used[at], 1 / noise[at], 0.0)
        across, down = jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 1.0, 1.0])
        columns = jnp.stack(
            [
                across,
                jnp.array([0.0, 1.0, 0.0]),
                jnp.array([0.0, 0.0, 1.0]),
                slopes @ jnp.append(velocity, 0.0),
                half * across,
                half * down,
            ],
            -1,
        )
        return (edges[at] - predicted) * weight, columns * weight[:, None]

    def camera(rows):
        return explained(*jax.vmap(one)(state, velocity, half, rows), block)

    return jax.lax.map(camera, member.T)  # one camera at a time: columns are large


def residual_patterns(
    trails: Trails,
    kept: np.ndarray,
    groups: Groups,
    rate: Float[np.ndarray, "group cam"],
    boxes: Boxes,
    measurements: Measurements,
    views: GroundViews,
) -> Patterns | None:
    """Search the residuals of the reported people for patterns.

    Args:
        trails: the tracks.
        kept: (M,) whether the row is reported.
        groups: boxes of one person in one frame.
        rate: (H, C) probability that a camera detects the person of each group.
        boxes: the boxes.
        measurements: their edges and noise.
        views: the cameras.

    Returns:
        The patterns; None without people in several cameras.
    """
    rows = np.flatnonzero(kept & (trails.group >= 0))
    rows = rows[(groups.member[trails.group[rows]] >= 0).sum(1) >= 2]
    if not len(rows):
        return None
    group = trails.group[rows]
    member = groups.member[group]
    n, length = len(rows), fine_length(len(rows))
    frame = trails.frame[rows]
    half = np.where(frame < np.median(frame), -1.0, 1.0)
    _, block = np.unique(
        np.stack([trails.track[rows], frame // BLOCK], -1), axis=0, return_inverse=True
    )

    def pad(values: np.ndarray, fill: int = 0) -> np.ndarray:
        return np.pad(
            values,
            [(0, length - n)] + [(0, 0)] * (values.ndim - 1),
            constant_values=fill,
        )

    velocity = np.nan_to_num(trails.mean[rows, 3:])
    with jax.enable_x64(True):
        found = _explained(
            pad(trails.mean[rows, :3], 1), pad(velocity), pad(half), pad(block), pad(member, -1),
            np.asarray(measurements.edges), np.asarray(measurements.noise),
            np.asarray(measurements.used), boxes.view, np.asarray(views.matrix),
        )  # fmt: skip
    speed = np.linalg.norm(velocity, axis=1)
    walks = speed >= np.median(speed)
    return Patterns(
        Explained(*map(np.asarray, found)), seen_together(member[walks] >= 0, rate[group][walks])
    )


def seen_together(
    seen: Bool[np.ndarray, "person cam"], rate: Float[np.ndarray, "person cam"]
) -> Float[np.ndarray, "cam cam"]:
    """How often two cameras see people together, over how often they would by chance.

    Args:
        seen: (n, C) whether the camera sees the person.
        rate: (n, C) probability that it does.

    Returns:
        (C, C), NaN on the diagonal and where few are expected.
    """
    together = np.full((rate.shape[1],) * 2, np.nan)
    expected = rate.T @ rate
    observed = seen.T.astype(float) @ seen
    enough = (expected >= FEWEST_TOGETHER) & ~np.eye(len(expected), dtype=bool)
    together[enough] = observed[enough] / expected[enough]
    return together
