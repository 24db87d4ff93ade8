"""Which cameras join a rig, and a rig whose cameras share no people."""

from dataclasses import replace
from unittest import mock

import numpy as np
from hypothesis import given, strategies as st

from catfree.calibration.people.matching._verdict import weakest
from catfree.calibration.people.search import _growth
from catfree.calibration.people.search._growth import (
    CHANCE_SHARES,
    best_candidate,
    drop_harmful,
    fit_rig,
)
from tests.calibration.people.search.rigs_without_boxes import (
    CAMERAS,
    WORK,
    rig_of,
    state_of,
    verdict_of,
)

evidence = st.lists(st.integers(26, 500).map(float), min_size=3, max_size=CAMERAS)
gains = st.sampled_from([0.5, 1.0, 1.25, 1.5, 2.0, 3.0])


@given(evidence, gains)
def test_the_weakest_camera_leaves_if_the_others_have_more_evidence_without_it(margins, gain):
    rig = replace(rig_of(range(len(margins))), verdicts=dict(enumerate(map(verdict_of, margins))))

    def adjusted(_, state):
        left = np.flatnonzero(state.placed).tolist()
        verdicts = {c: verdict_of(gain * rig.verdicts[c].margin) for c in left}
        return replace(rig, state=state, verdicts=verdicts)

    with mock.patch.object(_growth, "fit_rig", adjusted):
        kept = drop_harmful(WORK, rig)
    strongest = sorted(margins)[1:]
    assert (len(kept.verdicts) < len(margins)) == (gain * sum(strongest) > sum(margins))
    assert len(kept.verdicts) >= 2
    assert min(margins[c] for c in kept.verdicts) >= sorted(margins)[-len(kept.verdicts)]
    assert kept.quality[1] >= rig.quality[1]


@given(st.sets(st.integers(0, CAMERAS - 1), min_size=3), st.integers(0, CAMERAS - 1))
def test_a_weak_camera_stays_if_the_others_see_nobody_in_common(cameras, at):
    rig = rig_of(cameras)
    weak = sorted(cameras)[at % len(cameras)]
    rig = replace(rig, verdicts={**rig.verdicts, weak: verdict_of(30.0)})
    assert weakest(rig.verdicts) == weak
    kept = drop_harmful(WORK, rig)
    assert set(np.flatnonzero(kept.state.placed)) == cameras
    assert kept.verdicts == rig.verdicts


def test_cameras_that_see_nobody_in_common_make_no_rig():
    assert fit_rig(WORK, state_of([0, 2])) is None


margins = st.lists(st.floats(26, 500), max_size=4)


@given(margins, st.lists(margins, min_size=len(CHANCE_SHARES), max_size=len(CHANCE_SHARES)))
def test_a_camera_joins_with_more_evidence_than_searches_at_shifted_times(true, shifted):
    searches = iter([list(enumerate(found)) for found in (true, *shifted)])

    def judged(*_):
        return {at: (np.full(7, margin), verdict_of(margin)) for at, margin in next(searches)}

    with (
        mock.patch.object(_growth, "voted_places", return_value=[]),
        mock.patch.object(_growth, "judge_refined", judged),
    ):
        found = best_candidate(WORK, state_of([0, 1]), 2)
    chance = max((margin for search in shifted for margin in search), default=0.0)
    best = max(true, default=0.0)
    assert (None if found is None else found[1].margin) == (best if best > chance else None)
