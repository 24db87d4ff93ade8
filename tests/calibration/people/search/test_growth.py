"""The search with cameras that share no people."""

from dataclasses import replace

import numpy as np
from hypothesis import given, strategies as st

from catfree.calibration.people.search._growth import drop_harmful, fit_rig
from tests.calibration.people.search.rigs_without_boxes import (
    CAMERAS,
    WORK,
    rig_of,
    state_of,
    verdict_of,
)


@given(st.sets(st.integers(0, CAMERAS - 1), min_size=3), st.integers(0, CAMERAS - 1))
def test_a_suspicious_camera_stays_if_the_others_see_nobody_in_common(cameras, at):
    rig = rig_of(cameras)
    suspicious = sorted(cameras)[at % len(cameras)]
    rig = replace(rig, verdicts={**rig.verdicts, suspicious: verdict_of(30.0)})
    kept = drop_harmful(WORK, rig)
    assert set(np.flatnonzero(kept.state.placed)) == cameras
    assert kept.verdicts == rig.verdicts


def test_cameras_that_see_nobody_in_common_make_no_rig():
    assert fit_rig(WORK, state_of([0, 2])) is None
