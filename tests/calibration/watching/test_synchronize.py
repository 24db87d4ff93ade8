"""Late cameras of a settled rig."""

from dataclasses import replace

import numpy as np
import pytest

from catfree.calibration.watching import synchronize
from catfree.settings import Settings
from tests.calibration.ring_world import ring_of_six, true_ring
from tests.calibration.watching.bumped import renumber

pytestmark = pytest.mark.slow


def refined(factor, share=1.0):
    """A refinement that changes nothing but the residual and the number of boxes that fit."""
    return lambda boxes, calibration: replace(
        calibration,
        residual=factor * calibration.residual,
        sightings=np.rint(share * calibration.sightings).astype(int),
    )


@pytest.fixture(scope="module")
def late():
    return renumber(ring_of_six().detections, 2, lambda frame: 2.0 + 0 * frame)


def test_a_late_camera_is_corrected_if_the_rig_fits_better_then(late):
    found, boxes = synchronize(true_ring(), late, Settings(), refined(0.9))
    assert (found.frame_offset - found.frame_offset[0]).tolist() == [0, 0, 2, 0, 0, 0]
    true = ring_of_six().detections.frame
    assert len(np.unique(boxes.frame - true)) == 1


def test_nothing_is_corrected_if_the_rig_fits_no_better(late):
    found, boxes = synchronize(true_ring(), late, Settings(), refined(1.0))
    assert not found.frame_offset.any()
    assert (boxes.frame == late.frame).all()


@pytest.mark.parametrize(("factor", "share", "kept"), [(1.02, 1.4, True), (0.9, 0.7, False)])
def test_boxes_that_fit_count_as_well_as_how_well_they_fit(late, factor, share, kept):
    """A late camera that lost most of its people may fit those that are left."""
    found, _ = synchronize(true_ring(), late, Settings(), refined(factor, share))
    assert found.frame_offset.any() == kept


def test_right_clocks_stay(late):
    on_time = ring_of_six().detections
    found, boxes = synchronize(true_ring(), on_time, Settings(), refined(0.5))
    assert not found.frame_offset.any()
    assert (boxes.frame == on_time.frame).all()
