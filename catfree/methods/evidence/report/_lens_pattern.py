"""A wrong lens model, as residuals that grow with the distance from the middle of the image.

Errors of a camera's pose, focal length and principal point move the image affinely, to first order.
What a wrong lens adds begins with the third power of the distance, along the radius.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from catfree.methods.evidence._huber_regression import huber_regression
from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.learn._noise import left_out_residuals
from catfree.types._validation import shown_camera

FEWEST_CAMERAS = 3  # with one other camera, nobody knows which of the two is wrong
FEWEST_BOXES = 50  # of a camera
OUTER = 0.95  # share of the boxes' ends that are nearer to the middle than where the bend counts
SIGNIFICANT = 6.0  # standard deviations; boxes of one person are not independent
UNKNOWN = 1e3  # standard deviation of a coefficient without residuals: no lens bends as much
NOTICEABLE = 0.02  # radians; right lenses left up to 0.012, fisheyes taken for pinholes 0.04


def lens_pattern(
    residual: Float[np.ndarray, "n 2"],
    offset: Float[np.ndarray, "n 2"],
    precision: Float[np.ndarray, "n 2"],
) -> tuple[float, float]:
    """Fit what a wrong lens leaves to the residuals of a camera, beside an affine map.

    Args:
        residual: (n, 2) observed minus predicted image points, in focal lengths.
        offset: (n, 2) the points, relative to the principal point, in focal lengths.
        precision: (n, 2) inverse standard deviations of the residuals; 0 for none.

    Returns:
        strength: coefficient of offset * |offset|² in the residual, as in Brown-Conrady's k1.
        deviation: its standard deviation if residuals are independent; `UNKNOWN` without residuals.

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
    """Measure how far the lens of each camera bends otherwise than the rig says.

    Args:
        state: with the people to report.

    Returns:
        (C,) angle by which people near the border of the image are off the places where the others
        see them, in radians; 0 where it is not significant. It grows with the third power of the
        distance from the middle.
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
        # The center column is one residual of two ends.
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
    """One sentence if the lenses of cameras seem to be wrong."""
    bent = [shown_camera(c, camera_names) for c in np.flatnonzero(bend > NOTICEABLE).tolist()]
    if not bent:
        return ()
    cameras = ("Camera " if len(bent) == 1 else "Cameras ") + ", ".join(bent)
    return (
        f"{cameras} and the other cameras disagree about people the more, the farther they are "
        "from the middle of the image: the lens model seems to be wrong. Pass the distortion of "
        "the lens, or `lens` if it is a fisheye.",
    )
