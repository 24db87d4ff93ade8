"""Detection of a wrong lens model from residuals that grow toward the image border.

Errors of a camera's pose, focal length and principal point move the image affinely, to first order.
A wrong lens adds a radial displacement whose lowest order is the cube of the distance from the
center.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from catfree.methods.evidence._huber_regression import huber_regression
from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.learn._noise import left_out_residuals
from catfree.types._validation import shown_camera

FEWEST_CAMERAS = 3  # with only two, it is unknown which one is wrong
FEWEST_BOXES = 50  # of a camera
OUTER = 0.95  # quantile of the distances of box ends at which the bend is measured
SIGNIFICANT = 6.0  # standard deviations; boxes of one person are not independent
UNKNOWN = 1e3  # standard deviation of a coefficient without residuals; no lens bends as much
NOTICEABLE = 0.02  # radians; correct lenses left up to 0.012, fisheyes taken for pinholes 0.04


def lens_pattern(
    residual: Float[np.ndarray, "n 2"],
    offset: Float[np.ndarray, "n 2"],
    precision: Float[np.ndarray, "n 2"],
) -> tuple[float, float]:
    """Fit the cubic radial term of a wrong lens, and an affine map, to the residuals of a camera.

    Args:
        residual: (n, 2) observed minus predicted image points, in focal lengths.
        offset: (n, 2) the points, relative to the principal point, in focal lengths.
        precision: (n, 2) inverse standard deviations of the residuals; 0 for none.

    Returns:
        strength: coefficient of offset * |offset|² in the residual, as in Brown-Conrady's k1.
        deviation: standard deviation if residuals are independent; `UNKNOWN` without residuals.

    Source:
        Brown, "Close-range camera calibration" (1971), for the first radial coefficient.
    """
    design = np.zeros((len(offset), 2, 7))
    design[:, 0, 0] = design[:, 1, 1] = 1
    design[:, 0, 2:4] = design[:, 1, 4:6] = offset
    design[:, :, 6] = offset * (offset[:, :1] ** 2 + offset[:, 1:] ** 2)
    design *= precision[..., None]
    coefficients, covariance = huber_regression(
        design.reshape(-1, 7), (residual * precision).ravel(), np.full(7, UNKNOWN), scale=1.0
    )
    return float(coefficients[-1]), float(np.sqrt(covariance[-1, -1]))


def lens_bends(state: EvidenceState) -> Float[np.ndarray, " cam"]:
    """Measure how far the lens of each camera deviates from the rig's model.

    Args:
        state: includes the people to report.

    Returns:
        (C,) angle in radians between people near the image border and where the other cameras see
        them; 0 if not significant. It grows with the cube of the distance from the center.
    """
    groups, boxes, views = state.groups, state.boxes, state.views
    chosen = state.trails.group[state.shown]
    strong = chosen[(groups.member[chosen] >= 0).sum(1) >= FEWEST_CAMERAS]
    by_end = np.array([[0, 1], [0, 2]])
    bend = np.zeros(groups.member.shape[1])
    for camera, column in enumerate(groups.member[strong].T):
        seen = np.flatnonzero(column >= 0)
        if len(seen) < FEWEST_BOXES:
            continue
        row = column[seen]
        found = left_out_residuals(
            row, strong[seen], groups, state.measurements, boxes, views, state.noise
        )
        box, focal = boxes.box[row], views.focal[boxes.view[row]][:, None]
        middle = (box[:, 0] + box[:, 2]) / 2
        ends = np.stack([np.stack([middle, box[:, k]], -1) for k in (1, 3)], 1)
        offset = (ends - views.center[camera]) / views.focal[camera]
        # The center column is one residual for both ends.
        precision = np.where(found.used, np.array([0.5, 1, 1]) ** 0.5 * focal / found.sd, 0.0)
        residual = np.where(found.used, found.residual / focal, 0.0)
        samples = residual[:, by_end], offset, precision[:, by_end]
        strength, deviation = lens_pattern(*(part.reshape(-1, 2) for part in samples))
        outer = np.quantile(np.linalg.norm(offset, axis=-1), OUTER)
        if abs(strength) > SIGNIFICANT * deviation:
            bend[camera] = abs(strength) * outer**3
    return bend


def lens_warnings(
    bend: Float[np.ndarray, " cam"], camera_names: Sequence[str] | None = None
) -> tuple[str, ...]:
    """Warn if the lens models of cameras seem to be wrong."""
    bent = [shown_camera(c, camera_names) for c in np.flatnonzero(bend > NOTICEABLE).tolist()]
    if not bent:
        return ()
    cameras = ("Camera " if len(bent) == 1 else "Cameras ") + ", ".join(bent)
    return (
        f"{cameras} and the other cameras disagree more about people who are farther from the "
        "middle of the image: the lens model seems to be wrong. Pass the distortion of the lens, "
        "or `lens` if it is a fisheye.",
    )
