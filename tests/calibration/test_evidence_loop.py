"""Misplaced cameras are found and moved, and no longer exclude others."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.calibration._evidence_loop import EvidenceLoop, largest_move
from catfree.calibration.people import reconsider, without_camera
from catfree.errors import CalibrationError
from catfree.geometry import fit_similarity
from catfree.settings import Settings
from tests.calibration.ring_world import moved, ring_of_six, true_ring
from tests.calibration.watching.bumped import renumber

pytestmark = pytest.mark.slow

SETTINGS = Settings()
WRONG, MISSING = 2, 5


@pytest.fixture(scope="module")
def world():
    return ring_of_six()


@pytest.fixture(scope="module")
def loop(world):
    return EvidenceLoop(world.detections, SETTINGS, lambda *_: None)


@pytest.fixture(scope="module")
def right(loop):
    found = loop.refine(true_ring())
    assert found.scene.rig.registered.all()
    return found


def furthest(found, right):
    """Return the largest position error of a camera in meters, ignoring NaN.

    The rig as a whole may have moved: people do not determine its place on the ground.
    """
    known = np.asarray(found.scene.rig.registered)
    center, place = (np.asarray(one.scene.rig.centers)[known] for one in (found, right))
    return np.linalg.norm(np.asarray(fit_similarity(center, place)(center)) - place, axis=1).max()


def test_a_rig_in_order_stays_as_it_is(world, right):
    assert reconsider(right, world.detections, SETTINGS.calibration) is None


@pytest.mark.parametrize("step", [(1.5, -1.0), (2.5, -1.7), (-2.0, 2.0)])
def test_a_camera_beside_its_place_is_taken_to_it(loop, right, step):
    found = loop.settle(moved(right, WRONG, *step))
    assert found.scene.rig.registered.all()
    assert furthest(found, right) < 0.3


def test_a_camera_without_people_is_placed_anew(loop, right):
    away = loop.refine(moved(right, WRONG, 2.5, -1.7))
    assert furthest(away, right) > 1.0
    found = loop.settle(away)
    assert found.sightings.sum() > away.sightings.sum()
    assert furthest(found, right) < 0.3


def test_a_rig_that_lacks_a_camera_and_has_another_beside_its_place(loop, right):
    lacking = without_camera(moved(right, WRONG, 1.5, -1.0), MISSING)
    found = loop.settle(lacking)
    assert found.scene.rig.registered.all()
    assert furthest(found, right) < 0.3


usual = st.floats(0.9, 1.1)


@given(st.lists(usual, min_size=3, max_size=6), st.integers(0, 5), st.floats(0.01, 100.0))
def test_the_camera_that_stands_out_is_the_outlier_at_any_scale(loop, right, values, at, scale):
    at %= len(values)
    residual = np.full(6, np.nan)
    residual[: len(values)] = values
    assert loop.outlier(replace(right, camera_residual=scale * residual)) is None
    residual[at] = 1.3 * SETTINGS.calibration.strained_residual
    assert loop.outlier(replace(right, camera_residual=scale * residual)) == at
    assert loop.outlier(replace(right, camera_residual=np.full(6, np.nan))) is None


def test_the_worst_of_two_outliers_comes_first(loop, right):
    residual = np.array([1.0, 3.0, 1.0, 1.0, 4.0, 1.0])
    assert loop.outlier(replace(right, camera_residual=residual)) == 4


def test_a_camera_that_fits_nowhere_is_flagged_in_the_end(world, loop, right):
    assert loop.without_outliers(right) is right
    beside = moved(right, WRONG, 2.5, -1.7)
    residual = right.camera_residual.copy()
    residual[WRONG] *= 1.1 * SETTINGS.calibration.strained_residual
    found = loop.without_outliers(replace(beside, camera_residual=residual))
    assert found.scene.rig.registered.tolist() == [camera != WRONG for camera in range(6)]
    assert furthest(found, right) < 0.3


def test_cameras_that_agree_on_nobody_do_not_outvote_one(world, right):
    class Thin(EvidenceLoop):
        def refine_once(self, calibration):
            return None

    loop = Thin(world.detections, SETTINGS, lambda *_: None, [f"gate {c}" for c in range(6)])
    residual = right.camera_residual.copy()
    residual[WRONG] *= 2 * SETTINGS.calibration.strained_residual
    outlier = replace(right, camera_residual=residual)
    with pytest.raises(CalibrationError, match="Camera 'gate 2' contradicts the others"):
        loop.without_outliers(outlier)
    for camera in (0, 1, MISSING):
        outlier = without_camera(outlier, camera)
    pair = loop.without_outliers(outlier)  # two cameras never share confident people
    assert pair.scene.rig.registered.tolist() == [c in (3, 4) for c in range(6)]


def test_where_nobody_is_sure_nothing_moves(world, right):
    empty = world.detections[:0]
    loop = EvidenceLoop(empty, SETTINGS, lambda *_: None)
    assert loop.refine_once(right) is None
    assert loop.refine(right) is right


@pytest.mark.parametrize(
    ("rounds", "chosen", "done"),
    [
        # (residual, distance of a camera from its start in standard deviations)
        ([(9.0, 5.0), (3.0, 9.0), (3.0, 9.1)], (3.0, 9.1), 3),  # converged
        ([(3.0, 5.0), (3.02, 9.0), (3.0, 9.1)], (3.0, 9.1), 3),  # 2 % of information are equal
        ([(3.0, 5.0), (3.1, 9.0), (2.0, 9.1)], (3.0, 5.0), 2),  # a larger loss is undone
        ([(3.0, 0.1), (2.0, 0.1)], (3.0, 0.1), 1),
        ([(3.0, 5.0), None], (3.0, 5.0), 2),
        ([(9.0, float(k)) for k in range(1, 8)], (9.0, 5.0), 5),  # at most evidence_rounds
    ],
)
def test_rounds_go_on_until_the_rig_rests(world, right, rounds, chosen, done):
    left = list(rounds)
    variance = np.trace(right.center_covariance[WRONG]) / 3

    def after(residual, way):
        return replace(moved(right, WRONG, way * np.sqrt(variance), 0.0), residual=residual)

    class Scripted(EvidenceLoop):
        def refine_once(self, calibration):
            step = left.pop(0)
            return step and after(*step)

    found = Scripted(world.detections, SETTINGS, lambda *_: None).refine(right)
    assert found.residual == chosen[0]
    np.testing.assert_allclose(found.scene.rig.centers, after(*chosen).scene.rig.centers)
    assert len(rounds) - len(left) == done


@given(
    step=st.tuples(*[st.floats(-3, 3)] * 2),
    camera=st.integers(0, 5),
    scale=st.floats(0.1, 10),
)
def test_a_move_is_measured_in_deviations_of_the_camera_that_moved_most(right, step, camera, scale):
    there = moved(right, camera, *step)
    expected = np.hypot(*step) / np.sqrt(np.trace(right.center_covariance[camera]) / 3)
    assert largest_move(right, there) == pytest.approx(expected, rel=1e-3, abs=1e-3)
    wider = replace(there, camera_covariance=there.camera_covariance * scale**2)
    assert largest_move(right, wider) == pytest.approx(largest_move(right, there) / scale)
    assert largest_move(right, right) == 0


@dataclass(frozen=True)
class Refined(EvidenceLoop):
    """A loop that changes only the residual and the number of fitting boxes."""

    factor: float = 1.0
    share: float = 1.0

    @classmethod
    def of(cls, boxes, factor, share=1.0):
        return cls(boxes, SETTINGS, lambda *_: None, None, factor, share)

    def refine(self, calibration):
        return replace(
            calibration,
            residual=self.factor * calibration.residual,
            sightings=np.rint(self.share * calibration.sightings).astype(int),
        )


@pytest.fixture(scope="module")
def late():
    return renumber(ring_of_six().detections, 2, lambda frame: 2.0 + 0 * frame)


def test_a_late_camera_is_corrected_if_the_rig_fits_better_then(late):
    loop = Refined.of(late, 0.9)
    found = loop.synchronized(true_ring())
    assert (found.frame_offset - found.frame_offset[0]).tolist() == [0, 0, 2, 0, 0, 0]
    true = ring_of_six().detections.frame
    assert len(np.unique(loop.boxes(found).frame - true)) == 1


def test_nothing_is_corrected_if_the_rig_fits_no_better(late):
    found = Refined.of(late, 1.0).synchronized(true_ring())
    assert not found.frame_offset.any()


@pytest.mark.parametrize(("factor", "share", "kept"), [(1.02, 1.4, True), (0.9, 0.7, False)])
def test_boxes_that_fit_count_as_well_as_how_well_they_fit(late, factor, share, kept):
    """A late camera that lost most of its people may fit the remaining ones."""
    found = Refined.of(late, factor, share).synchronized(true_ring())
    assert found.frame_offset.any() == kept


def test_right_clocks_stay(late):
    on_time = ring_of_six().detections
    found = Refined.of(on_time, 0.5).synchronized(true_ring())
    assert not found.frame_offset.any()
