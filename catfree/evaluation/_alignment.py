"""Alignment of a reconstruction with the annotations, and its influence on the score."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float, Int

from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.evaluation._position_matching import matched_rows
from catfree.evaluation._rows import Number, read_sequence
from catfree.geometry import Similarity, fit_similarity
from catfree.geometry._arrays import ArrayInput
from catfree.types._validation import as_float, as_positive, as_registered

MINIMUM_CENTERS = 3


def align_centres(
    estimated_centres: ArrayInput,
    true_centres: ArrayInput,
    *,
    registered: ArrayInput | None = None,
    fixed_scale: bool = False,
) -> Similarity:
    """Fit the similarity from estimated to annotated camera centers.

    The alignment removes the gauge freedom of a reconstruction (position, orientation, scale)
    without using any person. It is computed in JAX's default float width.

    Args:
        estimated_centres: (C, 3) in scene units.
        true_centres: (C, 3) in meters, the same cameras in the same order.
        registered: (C,) which cameras to use, None for all; unused centers may be NaN.
        fixed_scale: keep the scene's scale (a rigid alignment, six degrees of freedom).

    Returns:
        The transform from scene units to meters.

    Raises:
        InvalidInputError: if the shapes differ or a used center is not finite.
        InsufficientDataError: if fewer than three cameras are used.
        DegenerateGeometryError: if the centers lie on one line.

    Source:
        CAT-Free, evaluation protocol: a 7-DoF similarity fitted to the camera centers.
    """
    estimated, true, used = _paired_centers(estimated_centres, true_centres, registered)
    if len(used) < MINIMUM_CENTERS:
        raise InsufficientDataError(
            f"Cannot align camera centers: {len(used)} cameras, {MINIMUM_CENTERS} needed."
        )
    return fit_similarity(estimated[used], true[used], fixed_scale=fixed_scale)


def _paired_centers(
    estimated: ArrayInput, true: ArrayInput, registered: ArrayInput | None
) -> tuple[Float[np.ndarray, "cam 3"], Float[np.ndarray, "cam 3"], Int[np.ndarray, " used"]]:
    """Convert both arrays to float64 and return them with the indices of the used cameras."""
    estimated = np.asarray(as_float(estimated, "estimated_centres"), np.float64)
    true = np.asarray(as_float(true, "true_centres"), np.float64)
    if estimated.ndim != 2 or estimated.shape[1] != 3 or true.shape != estimated.shape:
        raise InvalidInputError(
            f"Camera centers must be two (C, 3) arrays, got {estimated.shape} and {true.shape}."
        )
    used = np.flatnonzero(as_registered(registered, len(true)))
    finite = np.isfinite(estimated[used]).all(axis=1) & np.isfinite(true[used]).all(axis=1)
    if not finite.all():
        raise InvalidInputError(
            f"The center of camera {used[np.argmin(finite)]} is not finite: mark it as not "
            "registered."
        )
    return estimated, true, used


@dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """Scores under alignments that each withhold one camera.

    Attributes:
        value: the score with all cameras.
        cameras: (L,) the withheld camera of each refit.
        values: (L,) the score of each refit.
        held_out_centre_error: (L,) distance between the withheld camera's aligned and annotated
            centers in meters: the quality of the rig itself.
    """

    value: float
    cameras: Int[np.ndarray, " l"]
    values: Float[np.ndarray, " l"]
    held_out_centre_error: Float[np.ndarray, " l"]

    @property
    def mean(self) -> float:
        """Mean score of the refits."""
        return float(self.values.mean())

    @property
    def min(self) -> float:
        """Worst score of the refits."""
        return float(self.values.min())

    @property
    def std(self) -> float:
        """Sample standard deviation of the refits' scores."""
        return float(self.values.std(ddof=1))

    def __str__(self) -> str:
        return (
            f"all cameras {self.value:.2f}  leave one out: mean {self.mean:.2f}  "
            f"min {self.min:.2f}  SD {self.std:.2f}  "
            f"held-out center error {self.held_out_centre_error.mean():.2f} m"
        )


def leave_one_camera_out(
    estimated_centres: ArrayInput,
    true_centres: ArrayInput,
    positions: ArrayInput,
    score_function: Callable[[Float[np.ndarray, "m 3"]], float],
    *,
    registered: ArrayInput | None = None,
    fixed_scale: bool = False,
) -> LeaveOneOut:
    """Refit the alignment without each camera in turn, and score again.

    Args:
        estimated_centres: (C, 3) in scene units.
        true_centres: (C, 3) in meters.
        positions: (M, 3) predictions in scene units, all of them scored each time.
        score_function: takes the aligned positions (M, 3) in meters and returns a number, for
            instance their MODA.
        registered: (C,) which cameras to use, None for all.
        fixed_scale: see `align_centres`.

    Returns:
        The scores, and the center error of each withheld camera.

    Raises:
        InsufficientDataError: if fewer than four cameras are used.
        InvalidInputError: as in `align_centres`, or if positions are not (M, 3).
        DegenerateGeometryError: if the remaining centers lie on one line.

    Source:
        CAT-Free, appendix "Effect of evaluation alignment" (Table gauge).
    """
    estimated, true, used = _paired_centers(estimated_centres, true_centres, registered)
    points = np.asarray(as_float(positions, "positions"), np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidInputError(f"positions must have shape (M, 3), got {points.shape}.")
    if len(used) <= MINIMUM_CENTERS:
        raise InsufficientDataError(
            f"Cannot leave one camera out: {len(used)} cameras, {MINIMUM_CENTERS + 1} needed."
        )

    subsets = [used, *(used[used != camera] for camera in used)]
    with jax.enable_x64(True):  # single precision resolves half a meter on a map
        fits = [fit_similarity(estimated[k], true[k], fixed_scale=fixed_scale) for k in subsets]
        moved = [np.asarray(fit(points)) for fit in fits]
        held_out = [
            np.asarray(fit(estimated[camera])) for fit, camera in zip(fits[1:], used, strict=True)
        ]
    value, *values = [float(score_function(positions)) for positions in moved]
    return LeaveOneOut(
        value=value,
        cameras=used,
        values=np.array(values),
        held_out_centre_error=np.linalg.norm(np.array(held_out) - true[used], axis=1),
    )


@dataclass(frozen=True, eq=False)
class PositionAlignment:
    """Position errors before and after an alignment on the people themselves.

    Attributes:
        similarity: 2-D transform from predicted to true x, y, as NumPy arrays of float64.
        rows: (P, 4) the transformed predictions.
        matched: number of pairs in the fit.
        rms_before: root mean square distance of those pairs in meters.
        rms_after: the same after the transform.
    """

    similarity: Similarity
    rows: Float[np.ndarray, "p 4"]
    matched: int
    rms_before: float
    rms_after: float

    def __str__(self) -> str:
        return (
            f"RMS {self.rms_before:.3f} m before, {self.rms_after:.3f} m after alignment on "
            f"{self.matched} positions (scale {float(self.similarity.scale):.4f})"
        )


def align_positions(
    ground_truth: ArrayInput,
    predictions: ArrayInput,
    threshold: Number = 1.0,
    *,
    fixed_scale: bool = False,
) -> PositionAlignment:
    """Align predictions with the annotated people: a diagnostic, never a score.

    If the error falls a lot, the calibration or its alignment is off rather than the localization.
    The fit uses the ground truth, so no metric of the moved rows may be reported as a result.

    Args:
        ground_truth: (G, 4) rows [frame, id, x, y], meters.
        predictions: (P, 4) rows of the same form, already roughly aligned.
        threshold: largest distance of a pair in meters.
        fixed_scale: keep scale 1.

    Returns:
        The alignment, the moved rows, and the errors before and after.

    Raises:
        InvalidInputError: naming the first bad row.
        InsufficientDataError: if fewer than two pairs are matched.
        DegenerateGeometryError: if all pairs coincide.
    """
    gate = as_positive(threshold, "threshold")
    sequence = read_sequence(ground_truth, predictions)
    truth, predicted = matched_rows(sequence, gate)
    if len(truth) < 2:
        raise InsufficientDataError(
            f"Cannot align positions: {len(truth)} predictions within {gate} m of the ground "
            "truth, 2 needed."
        )
    target = sequence.truth[truth, 2:]
    source = sequence.predicted[predicted, 2:]
    with jax.enable_x64(True):  # single precision resolves half a meter on a map
        similarity = fit_similarity(source, target, fixed_scale=fixed_scale)
        moved = np.asarray(similarity(sequence.predicted[:, 2:]))
    return PositionAlignment(
        similarity=jax.tree.map(np.asarray, similarity),
        rows=np.column_stack([sequence.predicted[:, :2], moved]),
        matched=len(truth),
        rms_before=float(np.sqrt(((source - target) ** 2).sum(axis=1).mean())),
        rms_after=float(np.sqrt(((moved[predicted] - target) ** 2).sum(axis=1).mean())),
    )
