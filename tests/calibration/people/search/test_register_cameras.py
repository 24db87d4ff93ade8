"""Which pairs of cameras begin a rig."""

from itertools import combinations
from unittest import mock

import numpy as np
from hypothesis import given, strategies as st

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people._radial_lens import RadialLenses
from catfree.calibration.people.adjustment._alternate import AdjustedRig
from catfree.calibration.people.adjustment._people_bundle import BundleResult
from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS
from catfree.calibration.people.matching._group_people import RigState
from catfree.calibration.people.matching._mutual_nearest import Judgment
from catfree.calibration.people.matching._verdict import PlacementVerdict
from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search import _register_cameras
from catfree.calibration.people.search._camera_pairs import PairHypothesis
from catfree.settings import CalibrationSettings

CAMERAS = 6
SHAPE = (CAMERAS, 1, 1)
NOBODY = BoxGrid(
    np.zeros((*SHAPE, 3)),
    np.ones(SHAPE),
    np.zeros(SHAPE, bool),
    np.full((CAMERAS, 2), 1000),
    np.zeros(1, np.int64),
)
WORK = Workspace(
    NOBODY, CalibrationSettings(), RadialLenses(np.full(CAMERAS, 1000.0), np.zeros(CAMERAS))
)


def state_of(cameras):
    parameters = np.full((CAMERAS, 7), np.nan)
    parameters[list(cameras)] = 0.0
    return RigState(parameters, RANGE_ERRORS[0])


def rig_of(cameras):
    """A rig in which every camera is trusted."""
    state = state_of(cameras)
    zeros = np.zeros(CAMERAS)
    bundle = BundleResult(
        state.parameters,
        np.zeros((0, 3)),
        0.0,
        0.0,
        zeros,
        zeros.astype(np.int64),
        np.zeros((7 * CAMERAS + 1, 7 * CAMERAS + 1)),
        zeros,
        zeros,
    )
    verdict = PlacementVerdict(Judgment(100.0, 1.0, 50), 100.0, ())
    return AdjustedRig(state, bundle, True, dict.fromkeys(cameras, verdict))


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
    pairs = [PairHypothesis(couple, state_of(couple), margin) for couple, margin in shared.items()]
    pairs.sort(key=lambda pair: -pair.margin)
    begun = []

    def adjusted(_, pair):
        begun.append(pair)
        return rig_of(pair.cameras)

    def grown(_, rig, __):
        of = site[min(rig.verdicts)]
        return rig_of([camera for camera in range(CAMERAS) if site[camera] == of])

    with (
        mock.patch.object(_register_cameras, "_adjusted", adjusted),
        mock.patch.object(_register_cameras, "grow_rig", grown),
    ):
        best = _register_cameras._grow_pairs(WORK, pairs, lambda *_: None)
    found = [site[pair.cameras[0]] for pair in begun]
    assert sorted(found) == sorted({site[a] for (a, _), margin in shared.items() if margin > 0})
    for pair in begun:
        of_site = [p.margin for p in pairs if site[p.cameras[0]] == site[pair.cameras[0]]]
        assert pair.margin == max(of_site)
    assert (best is None) == (not begun)
    if best is not None:
        assert best.quality[0] == max(site.count(of) for of in found)
