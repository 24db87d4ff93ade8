"""Rigs without boxes, for tests of the search rules."""

import numpy as np

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people._radial_lens import RadialLenses
from catfree.calibration.people.adjustment._people_bundle import BundleResult
from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS
from catfree.calibration.people.matching._group_people import RigState
from catfree.calibration.people.matching._verdict import PlacementVerdict
from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search._growth import AdjustedRig
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


def verdict_of(margin):
    return PlacementVerdict(100.0, 1.0, 50, margin, ())


def rig_of(cameras):
    """Make a rig in which every camera is trusted."""
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
    return AdjustedRig(state, bundle, dict.fromkeys(cameras, verdict_of(100.0)))
