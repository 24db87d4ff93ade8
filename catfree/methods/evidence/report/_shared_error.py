"""Uncertainty of the whole map due to camera pose errors, shared by all boxes of a camera.

Random errors of boxes average out over cameras and time, but the offset of a camera does not.
Residuals between cameras show only relative offsets; no residual shows a shift, rotation or scale g
of the whole map. If g moves the edges by J D g, then the offsets beta_c, common to all boxes of
camera c, change the map by

    g = T^-1 sum_c M_c beta_c,  T = sum D'J'W J D,  M_c = sum over the camera's boxes D'J'W f_c

With offsets of variance B drawn once per camera, Cov(g) = T^-1 (sum_c M_c B M_c') T^-1: the
cluster-robust covariance of Liang and Zeger (1986) with the cameras as clusters. B is the scatter
between cameras of the offsets found by self-calibration; their mean is a bias of the detector, not
an error of a pose.

The scatter of few cameras is itself uncertain. It has one degree of freedom less than there are
cameras, plus one for the prior scatter of a rig. Then g over its stated deviation follows Student's
t with as many degrees of freedom as there are cameras, and B is widened to match its 95 % ellipse.
This is the usual correction for few clusters (Cameron and Miller, 2015), with a prior, without
which two cameras would not be informative.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtri, stdtrit

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.observe._measurement import features_of
from catfree.methods.evidence.observe._sightings import sightings_by_camera
from catfree.settings import EvidenceSettings

MODES = 4  # shift along both axes, rotation, scale
UPPER = 0.975  # quantile of a two-sided 95 % interval


def shared_covariance(
    state: EvidenceState, settings: EvidenceSettings
) -> Float[np.ndarray, "node 2 2"]:
    """Covariance that camera pose errors add to each position, in H0².

    Args:
        state: includes the people to report and the offsets found by self-calibration.
        settings: for the assumed calibration error.

    Returns:
        (M, 2, 2), zero if fewer than two cameras have known offsets.

    Source:
        Liang and Zeger, "Longitudinal data analysis using generalized linear models" (1986);
        Cameron and Miller, "A practitioner's guide to cluster-robust inference" (2015), section VI.
    """
    trails, rows = state.trails, state.shown
    member = state.groups.member[trails.group[rows]]
    scatter = offset_scatter(member, state, settings)
    if scatter is None:
        return np.zeros((len(trails), 2, 2))
    middle = trails.mean[rows, :2].mean(0)
    modes = map_modes(trails.mean[:, :3], middle)
    normal, lever = mode_sums(trails.mean[rows, :3], modes[rows], member, state)
    spread = lever @ scatter @ lever.transpose(0, 2, 1)
    # One person at one position cannot separate rotation from shift; such modes get no variance.
    inverse = np.linalg.pinv(normal, rcond=1e-9, hermitian=True)
    covariance = inverse @ spread.sum(0) @ inverse
    flat = modes[:, :2]
    return flat @ covariance @ flat.transpose(0, 2, 1)


def mode_sums(
    people: Float[np.ndarray, "n 3"],
    modes: Float[np.ndarray, "n 3 4"],
    member: Int[np.ndarray, "n cam"],
    state: EvidenceState,
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "cam 4 3"]]:
    """Sum the information of n people's boxes on the modes of the map.

    Args:
        people: (n, 3) positions and heights in H0.
        modes: (n, 3, 4) result of `map_modes`.
        member: (n, C) the box of each person in each camera, -1 for none.
        state: the boxes.

    Returns:
        normal: (4, 4) information on the modes.
        lever: (C, 4, 3) right-hand side per radian of offset of a camera's edges.
    """
    normal, lever = np.zeros((MODES, MODES)), np.zeros((member.shape[1], MODES, 3))
    view, views = state.boxes.view, state.views
    of_cameras = sightings_by_camera(people, member, state.measurements, view, views)
    for camera, sightings in enumerate(of_cameras):
        moved = sightings.precision[..., None] * (
            sightings.slopes[..., :3] @ modes[sightings.person]
        )
        normal += np.einsum("nki,nkj->ij", moved, moved)
        focal = views.focal[view[sightings.box]]
        lever[camera] = np.einsum("nki,nk,n->ik", moved, sightings.precision, focal)
    return normal, lever


def map_modes(state: np.ndarray, middle: np.ndarray) -> Float[np.ndarray, "node 3 4"]:
    """Derivatives of states (M, 3) under a shift, rotation and scale of the map about `middle`."""
    away = state[:, :2] - middle
    modes = np.zeros((len(state), 3, MODES))
    modes[:, 0, 0] = modes[:, 1, 1] = 1
    modes[:, :2, 2] = np.stack([-away[:, 1], away[:, 0]], -1)
    modes[:, :2, 3] = away
    modes[:, 2, 3] = state[:, 2]
    return modes


def scatter_between(
    offsets: Float[np.ndarray, "cam 3"], assumed: float
) -> Float[np.ndarray, "3 3"]:
    """Variance between cameras, widened so that its Gaussian has correct 95 % coverage.

    Args:
        offsets: (C, 3) mean offset of each camera, at least one.
        assumed: usual standard deviation of offsets, weighted as one degree of freedom.
    """
    count = len(offsets)
    away = offsets - offsets.mean(0)
    widening = (stdtrit(count, UPPER) / ndtri(UPPER)) ** 2
    return widening * (away.T @ away + assumed**2 * np.eye(3)) / count


def offset_scatter(
    member: np.ndarray, state: EvidenceState, settings: EvidenceSettings
) -> Float[np.ndarray, "3 3"] | None:
    """Variance between cameras of their mean offset of (column, top, bottom), in square radians.

    Args:
        member: (n, C) boxes of people, -1 for none.
        state: includes the offsets.
        settings: for the assumed calibration error.

    Returns:
        (3, 3), or None if fewer than two cameras have offsets.
    """
    boxes, views, field = state.boxes, state.views, state.noise.field
    means = []
    for camera, has_offset in enumerate((field != 0).any((1, 2))):
        rows = member[member[:, camera] >= 0, camera]
        rows = rows[state.measurements.used[rows].all(1)]
        if has_offset and len(rows):
            offset = (features_of(boxes, rows, views) * field[camera]).sum(-1)
            means.append((offset / views.focal[boxes.view[rows]][:, None]).mean(0))
    if len(means) < 2:
        return None
    return scatter_between(np.array(means), settings.angular_noise)
