"""Patterns in each camera's residuals that box noise does not produce.

A late clock leaves residuals along the walking direction. A moved camera leaves different residuals
before and after the move. A rig that fits people despite such a pattern may be far off. For wrong
lenses, see `_lens_pattern`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.geometry._arrays import MEDIAN_TO_DEVIATION
from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.observe._measurement import features_of
from catfree.methods.evidence.observe._sightings import sightings_by_camera
from catfree.types._validation import shown_camera

# Columns of a late clock, and of a move (across, down); the first three columns are constant
# offsets.
_GROUPS = (slice(3, 4), slice(4, 6))
LARGEST = 4.0  # usual residuals of the camera, at which residuals are clipped
BLOCK = 12  # frames of a track whose errors count as one
LARGEST_SHARE = 0.15  # of the variance; sound simulated and real rigs reach 0.03
LEAST_TOGETHER = 0.6  # cameras that miss people independently are seldom below 0.95
FEWEST_TOGETHER = 20  # expected joint sightings needed to judge two cameras


class Explained(NamedTuple):
    """How much of one camera's residuals the patterns explain.

    Attributes:
        share: (2,) share of the variance that the clock, and a move in the middle, explain beyond
            chance; negative if less.
        coefficient: (3,) lag of the clock in usual steps, and the move in pixels across and down.
    """

    share: Float[np.ndarray, "*cam 2"]
    coefficient: Float[np.ndarray, "*cam 3"]


def explained(
    residual: Float[np.ndarray, "n 3"],
    columns: Float[np.ndarray, "n 3 6"],
    block: Int[np.ndarray, " n"],
) -> Explained:
    """Fit patterns to the residuals of one camera.

    The share expected by chance follows from the scatter of blocks, because a person's errors in
    successive frames are correlated.

    Args:
        residual: (n, 3) standardized residuals of the edges.
        columns: (n, 3, 6) design matrix: an offset of each coordinate in pixels, and the columns of
            `_GROUPS`; all 0 where there is no residual.
        block: (n,) block of each row, small numbers from 0; rows of one block count as one.

    Source:
        Liang and Zeger, "Longitudinal data analysis using generalized linear models" (1986), for
        the variance of sums over blocks.
    """
    present = (columns != 0).any(-1)
    usual = MEDIAN_TO_DEVIATION * np.median(np.abs(residual[present])) if present.any() else 0.0
    r = np.where(present, np.clip(residual, -LARGEST * usual, LARGEST * usual), 0.0)
    scale = np.sqrt(np.maximum((columns**2).sum((0, 1)), 1e-30))
    X = columns / scale
    normal = np.einsum("nka,nkb->ab", X, X)
    inverse = np.linalg.inv(normal + 1e-6 * np.eye(len(scale)))
    beta = inverse @ np.einsum("nka,nk->a", X, r)
    score = np.zeros((int(block.max(initial=-1)) + 1, len(scale)))
    np.add.at(score, block, np.einsum("nka,nk->na", X, r - X @ beta))
    blocks = len(np.unique(block[present.any(1)]))  # those seen by this camera
    free = max(blocks - len(scale), 0)  # residual degrees of freedom
    spread = inverse @ (score.T @ score) @ inverse * blocks / max(free, 1)
    constant = normal[:3, :3] + 1e-6 * np.eye(3)
    offset = np.linalg.solve(constant, np.einsum("nka,nk->a", X[..., :3], r))
    plain = r - X[..., :3] @ offset
    total = max(float((plain**2).sum()), 1e-12)
    shares = []
    for group in _GROUPS:
        weight = np.linalg.inv(inverse[group, group])
        saved = beta[group] @ weight @ beta[group]
        shares.append((saved - np.trace(weight @ spread[group, group])) / total)
    return Explained(np.array(shares) * (free > 0), (beta / scale)[3:])


class Patterns(NamedTuple):
    """How much the patterns explain in each camera.

    Attributes:
        explained: the `Explained` of all cameras, with a leading camera axis.
        shift: (C, 2) distance in H0 by which the clock and the move displace people who walk.
        together: (C, C) `seen_together` of the faster half of the people, because standing people
            do not reveal clock errors.
    """

    explained: Explained
    shift: Float[np.ndarray, "cam 2"]
    together: Float[np.ndarray, "cam cam"]

    @property
    def largest_shift(self) -> float:
        """Largest shift of any camera with a strong pattern, in H0.

        Exact boxes show errors that displace people by less than their positions are off.
        """
        strong = self.explained.share > LARGEST_SHARE
        return float(np.max(self.shift, initial=0.0, where=strong))

    @property
    def least_together(self) -> float:
        """Smallest entry of `together`; NaN if there is none."""
        known = self.together[np.isfinite(self.together)]
        return float(known.min()) if len(known) else float("nan")

    def sentences(self, camera_names: Sequence[str] | None = None) -> tuple[str, ...]:
        """Describe the cameras with a strong pattern."""
        warnings = []
        shares, coefficients = self.explained.share, self.explained.coefficient
        for camera, kind in np.argwhere(shares > LARGEST_SHARE).tolist():
            name = shown_camera(camera, camera_names)
            late = -float(coefficients[camera, 0])
            moved = float(np.hypot(*coefficients[camera, 1:]))
            warnings.append(
                (
                    f"The boxes of camera {name} are {'behind' if late > 0 else 'ahead of'} "
                    f"the people by {abs(late):.1f} frames: correct its clock.",
                    f"Camera {name} shows people {2 * moved:.0f} pixels apart in the two halves "
                    "of the recording: it was moved; calibrate each half separately.",
                )[kind]
            )
        low = np.triu(np.nan_to_num(self.together, nan=np.inf) < LEAST_TOGETHER)
        for pair in np.argwhere(low).tolist():
            one, other = (shown_camera(camera, camera_names) for camera in pair)
            warnings.append(
                f"Cameras {one} and {other} hardly ever see the same person at the same time, "
                "though both should: a clock or a pose is wrong, and people count twice."
            )
        return tuple(warnings)


def residual_patterns(state: EvidenceState) -> Patterns | None:
    """Search the residuals of the reported people for patterns; None if nobody is seen twice."""
    trails, groups, measurements = state.trails, state.groups, state.measurements
    rows = state.shown
    rows = rows[(groups.member[trails.group[rows]] >= 0).sum(1) >= 2]
    if not len(rows):
        return None
    group = trails.group[rows]
    member = groups.member[group]
    frame = trails.frame[rows]
    half = np.where(frame < np.median(frame), -1.0, 1.0)
    half -= half.mean()  # a single instant has no halves
    _, block = np.unique(
        np.stack([trails.track[rows], frame // BLOCK], -1), axis=0, return_inverse=True
    )
    velocity = np.nan_to_num(trails.mean[rows, 3:])
    explained_by_camera, pixels_by_camera = [], []
    boxes, views, field = state.boxes, state.views, state.noise.field
    for camera, sightings in enumerate(
        sightings_by_camera(trails.mean[rows, :3], member, measurements, boxes.view, views)
    ):
        columns = np.zeros((len(sightings.person), 3, 6))
        columns[:, range(3), range(3)] = 1
        columns[..., 3] = np.einsum(
            "nki,ni->nk", sightings.slopes[..., :2], velocity[sightings.person]
        )
        columns[:, 0, 4] = columns[:, 1, 5] = columns[:, 2, 5] = half[sightings.person]
        offset = (features_of(boxes, sightings.box, views) * field[camera]).sum(-1)
        edges = boxes.edges[sightings.box] - offset
        residual = (edges - sightings.edges) * sightings.precision
        explained_by_camera.append(
            explained(residual, columns * sightings.precision[..., None], block[sightings.person])
        )
        # Pixels per H0 of a foot that moves across the image, and along the view.
        pixels = np.linalg.norm(sightings.slopes[:, ::2, :2], axis=-1)
        pixels_by_camera.append(np.median(pixels, axis=0) if len(pixels) else np.ones(2))
    speed = np.linalg.norm(velocity, axis=1)
    walks = speed >= np.median(speed)
    found = Explained(*map(np.array, zip(*explained_by_camera, strict=True)))
    late = np.abs(found.coefficient[:, 0]) * np.median(speed[walks])
    moved = np.hypot(*(found.coefficient[:, 1:] / np.maximum(pixels_by_camera, 1e-9)).T)
    return Patterns(
        found,
        np.column_stack([late, moved]),
        seen_together(member[walks] >= 0, state.existence.rate[group][walks]),
    )


def seen_together(
    is_seen: Bool[np.ndarray, "person cam"], rate: Float[np.ndarray, "person cam"]
) -> Float[np.ndarray, "cam cam"]:
    """Compute how often two cameras see people together, relative to chance.

    Args:
        is_seen: (n, C) whether the camera sees the person.
        rate: (n, C) probability that it does.

    Returns:
        (C, C), NaN on the diagonal and where few joint sightings are expected.
    """
    together = np.full((rate.shape[1],) * 2, np.nan)
    expected = rate.T @ rate
    observed = is_seen.T.astype(float) @ is_seen
    enough = (expected >= FEWEST_TOGETHER) & ~np.eye(len(expected), dtype=bool)
    together[enough] = observed[enough] / expected[enough]
    return together
