"""The choice of the camera pair that begins a rig."""

from itertools import combinations
from unittest import mock

import numpy as np
from hypothesis import given, strategies as st

from catfree.calibration.people.search import _register_cameras
from tests.calibration.people.search.rigs_without_boxes import CAMERAS, WORK, rig_of, state_of


@given(
    site=st.lists(st.integers(0, 2), min_size=CAMERAS, max_size=CAMERAS),
    couples=st.permutations(list(combinations(range(CAMERAS), 2))),
    sharing=st.sets(st.tuples(st.integers(0, CAMERAS - 1), st.integers(0, CAMERAS - 1))),
)
def test_the_first_pair_begins_a_rig_at_each_site_and_the_largest_is_returned(
    site, couples, sharing
):
    begun = []

    def searched(_, one, two):
        shared = (one, two) in sharing and site[one] == site[two]
        return state_of((one, two)) if shared else None

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
        best = _register_cameras._grow_pairs(WORK, couples, lambda *_: None)
    found = [(one, two) for one, two in couples if searched(WORK, one, two) is not None]
    firsts = {site[one]: (one, two) for one, two in reversed(found)}
    assert sorted(begun) == sorted(firsts.values())
    assert (best is None) == (not begun)
    if best is not None:
        assert best.quality[0] == max(site.count(one) for one in firsts)
