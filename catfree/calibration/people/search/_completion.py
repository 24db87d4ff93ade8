"""Try cameras that growth left out at every position that their boxes allow.

While a rig grows, a camera is refined against a fixed map, and it can match as many people at a
wrong position as at the right one. Only a joint adjustment separates the two, so every position is
adjusted jointly. Positions are compared by the residual of the whole rig, since a misplaced camera
that distorts the others may match more people.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from catfree.calibration.people._residual_outliers import residual_outliers
from catfree.calibration.people.adjustment._alternate import AdjustedRig, alternate
from catfree.calibration.people.cameras._camera_model import X
from catfree.calibration.people.matching._group_people import RigState
from catfree.calibration.people.matching._verdict import Verdict, judge_cameras
from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search._growth import (
    RESECTED_TOLERANCE,
    accepted_candidates,
    drop_harmful,
)
from catfree.calibration.people.search._seed_pairs import PairHypothesis

JudgedRig = tuple[AdjustedRig, dict[int, Verdict]]

# Assumed errors of the others' map, as fractions of the range; they determine the candidates.
MAP_TOLERANCES = (0.01, 0.05, 0.08)
ADJUSTMENTS = (0.05, 0.03, 0.02)
SAME_PLACE = 0.3  # meters; closer candidates converge to one position


def complete_rig(
    work: Workspace,
    rig: AdjustedRig,
    verdicts: dict[int, Verdict],
    *,
    pairs: list[PairHypothesis],
    shared_focal: bool,
) -> JudgedRig:
    """Add every camera that has a position where it and all others pass their evidence checks.

    Args:
        work: the sequence.
        rig: the cameras placed by growth.
        verdicts: of each placed camera.
        pairs: all pair hypotheses.
        shared_focal: whether all cameras have one focal length.

    Returns:
        The rig, with cameras added if possible, and the verdicts of its cameras. A rig that would
        have fewer than `fewest_to_compare` cameras is unchanged.
    """
    for camera in np.flatnonzero(~rig.state.placed):
        if rig.state.placed.sum() + 1 < work.settings.fewest_to_compare:
            break
        accepted = [
            judged
            for start in _candidates(work, rig.state, int(camera), pairs, shared_focal)
            if (judged := _adjusted_with(work, rig.state, int(camera), start, shared_focal))
            is not None
        ]
        if accepted:
            rig, verdicts = min(accepted, key=lambda judged: judged[0].bundle.residual)
    return rig, verdicts


def _candidates(
    work: Workspace,
    state: RigState,
    camera: int,
    pairs: list[PairHypothesis],
    shared_focal: bool,
) -> list[Float[np.ndarray, "7"]]:
    """Distinct accepted candidates (7,) of a camera, before joint adjustment."""
    places: list[np.ndarray] = []
    for tolerance in MAP_TOLERANCES:
        loose = replace(state, range_tolerance=np.full(len(state.placed), tolerance))
        for start, _ in accepted_candidates(work, loose, camera, pairs, shared_focal):
            if all(np.linalg.norm(start[X:] - other[X:]) > SAME_PLACE for other in places):
                places.append(start)
    return places


def _adjusted_with(
    work: Workspace,
    state: RigState,
    camera: int,
    start: Float[np.ndarray, "7"],
    shared_focal: bool,
) -> JudgedRig | None:
    """Add a camera and adjust the rig; None if any camera is then rejected."""
    larger = state.with_camera(camera, start, RESECTED_TOLERANCE)
    rig = alternate(
        work.grid, larger, work.settings, shared_focal=shared_focal, tolerances=ADJUSTMENTS
    )
    if residual_outliers(rig.bundle.camera_residual, work.settings)[camera]:
        return None
    verdicts = judge_cameras(work, rig.state)
    if not all(verdict.accepted for verdict in verdicts.values()):
        return None
    rig, verdicts = drop_harmful(work, rig, verdicts, shared_focal=shared_focal)
    return (rig, verdicts) if len(verdicts) == larger.placed.sum() else None
