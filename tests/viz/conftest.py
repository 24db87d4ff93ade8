import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

from matplotlib import pyplot

import catfree as cf
from catfree.synthetic import make_world


@pytest.fixture(scope="session")
def world():
    return make_world("ring4", 3, frames=12, people=6)


@pytest.fixture(scope="session")
def localization(world):
    found = cf.localize(world.detections, world.scene, cf.Settings.paper())
    assert len(np.unique(found.tracks.track_id)) >= 3
    return found


@pytest.fixture(autouse=True)
def no_open_figures():
    yield
    pyplot.close("all")
