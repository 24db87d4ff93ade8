"""The choice of the camera pair that begins a rig."""

from itertools import combinations
from unittest import mock

import numpy as np
from hypothesis import given, strategies as st

from catfree.calibration.people.search import _register_cameras
from catfree.calibration.people.search._camera_pairs import PairHypothesis
from tests.calibration.people.search.rigs_without_boxes import CAMERAS, WORK, rig_of, state_of


@given(
    site=st.lists(st.integers(0, 2), min_size=CAMERAS, max_size=CAMERAS),
    margins=st.lists(st.integers(-5, 50).map(float), min_size=15, max_size=15),
)
def test_one_pair_begins_a_rig_at_each_site_and_the_largest_rig_is_returned(site, margins):
    couples = list(combinations(range(CAMERAS), 2))
    shared = {
        couple: margin if site[couple[0]] == site[couple[1]] else -1.0
        for couple, margin in zip(couples, margins, strict=True)
    }
    begun = []

    def searched(_, one, two):
        return PairHypothesis(state_of((one, two)), shared[one, two])

    def fitted(_, state):
        return rig_of(np.flatnonzero(state.placed).tolist())

    def grown(_, rig):
        begun.append(tuple(rig.verdicts))
        of = site[min(rig.verdicts)]
        return rig_of([camera for camera in range(CAMERAS) if site[camera] == of])

    with (
        mock.patch.object(_register_cameras, "search_pair", searched),
        mock.patch.object(_register_cameras, "fit_rig", fitted),
        mock.patch.object(_register_cameras, "grow_rig", grown),
    ):
        pairs = _register_cameras._search_pairs(WORK, lambda *_: None)
        best = _register_cameras._grow_pairs(WORK, pairs, lambda *_: None)
    sharing = {couple: margin for couple, margin in shared.items() if margin > 0}
    assert sorted(site[one] for one, _ in begun) == sorted({site[one] for one, _ in sharing})
    for couple in begun:
        of_site = [margin for (one, _), margin in sharing.items() if site[one] == site[couple[0]]]
        assert sharing[couple] == max(of_site)
    assert (best is None) == (not begun)
    if best is not None:
        assert best.quality[0] == max(site.count(site[one]) for one, _ in begun)
