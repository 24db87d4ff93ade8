"""Cameras that growth left out, tried once more at every place that their boxes allow.

While a rig grows, a camera is refined against a map that stays; beside its place it can match as
many people as in it. Whether it pulls the others along or they pull it home shows only when all are
adjusted together, so each place is tried to the end, and the places are compared there: by the
residual of the whole rig, since a camera that bends the others may well match more than they did.
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

Judged = tuple[AdjustedRig, dict[int, Verdict]]

# How far the others' map may still be wrong, as a share of the range: what is allowed there decides
# which places the boxes allow.
MAP_TOLERANCES = (0.01, 0.05, 0.08)
ADJUSTMENTS = (0.05, 0.03, 0.02)
SAME_PLACE = 0.3  # metres; adjusted together, such places become one


def complete_rig(
    work: Workspace,
    rig: AdjustedRig,
    verdicts: dict[int, Verdict],
    *,
    pairs: list[PairHypothesis],
    shared_focal: bool,
) -> Judged:
    """Add every camera that has a place in which it and all others stand up to their evidence.

    Args:
        work: the sequence.
        rig: the cameras that growth could place.
        verdicts: of each of them.
        pairs: all pair hypotheses.
        shared_focal: whether all cameras have one focal length.

    Returns:
        The rig, larger where a camera was found, and the verdicts of its cameras. Rigs that would
        have fewer cameras than can be compared (`fewest_to_compare`) stay as they are.
    """
    for camera in np.flatnonzero(~rig.state.placed):
        if rig.state.placed.sum() + 1 < work.settings.fewest_to_compare:
            break
        found = [
            judged
            for start in _places(work, rig.state, int(camera), pairs, shared_focal)
            if (judged := _tried(work, rig.state, int(camera), start, shared_focal)) is not None
        ]
        if found:
            rig, verdicts = min(found, key=lambda judged: judged[0].bundle.residual)
    return rig, verdicts


def _places(
    work: Workspace,
    state: RigState,
    camera: int,
    pairs: list[PairHypothesis],
    shared_focal: bool,
) -> list[Float[np.ndarray, "7"]]:
    """Distinct places (7,) in which a camera stands up to its evidence before all are adjusted."""
    places: list[np.ndarray] = []
    for tolerance in MAP_TOLERANCES:
        loose = replace(state, range_tolerance=np.full(len(state.placed), tolerance))
        for start, _ in accepted_candidates(work, loose, camera, pairs, shared_focal):
            if all(np.linalg.norm(start[X:] - other[X:]) > SAME_PLACE for other in places):
                places.append(start)
    return places


def _tried(
    work: Workspace,
    state: RigState,
    camera: int,
    start: Float[np.ndarray, "7"],
    shared_focal: bool,
) -> Judged | None:
    """The rig with a camera from a start, or None if it does not hold all of its cameras."""
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
