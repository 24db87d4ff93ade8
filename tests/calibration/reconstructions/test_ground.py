"""The ground among walls, ceilings and tables."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from catfree.calibration.reconstructions._ground import Ground, find_ground
from catfree.errors import GroundRejectedError, InsufficientDataError
from catfree.geometry import Similarity, transform_plane, transform_rig
from catfree.synthetic import RigError, World, make_world
from catfree.types import Plane, Rig

pytestmark = pytest.mark.slow

NO_ERROR = RigError(0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def world() -> World:
    """Simulate people in front of six cameras 4.5 to 5 m high."""
    return make_world("ring6", 0, frames=6, rig_error=NO_ERROR)


def patch(
    rng: np.random.Generator, count: int, corner: tuple, first: tuple, second: tuple
) -> np.ndarray:
    """Draw points on a rectangle with 2 cm of noise."""
    share = rng.uniform(0, 1, (count, 2))
    exact = np.array(corner, float) + share @ np.array([first, second], float)
    return exact + rng.normal(0, 0.02, (count, 3))


def room(rng: np.random.Generator, *, floor: int, walls: int, ceiling: int = 0) -> np.ndarray:
    """Make a floor of 20 x 20 m, two walls 8 m high, a ceiling, and objects."""
    parts = [
        patch(rng, floor, (-10, -10, 0), (20, 0, 0), (0, 20, 0)),
        patch(rng, walls, (-12, -12, 0), (24, 0, 0), (0, 0, 8)),
        patch(rng, walls, (-12, -12, 0), (0, 24, 0), (0, 0, 8)),
        patch(rng, ceiling, (-10, -10, 8), (20, 0, 0), (0, 20, 0)),
        rng.uniform([-10, -10, 0], [10, 10, 6], (200, 3)),
    ]
    return np.concatenate(parts)


def assert_is_floor(found: Ground, *, normal=(0.0, 0.0, 1.0), rig: Rig, height: float = 0.0):
    angle = np.degrees(np.arccos(np.clip(found.plane.normal @ np.array(normal), -1, 1)))
    assert angle < 0.5
    under = np.asarray(rig.centers).mean(0) * [1, 1, 0] + [0, 0, height]
    assert abs(found.plane.signed_distance(under)) < 0.05


@pytest.mark.parametrize("with_people", [True, False])
@pytest.mark.parametrize(
    "contents",
    [
        {"floor": 1000, "walls": 0},
        {"floor": 700, "walls": 2500},
        {"floor": 150, "walls": 1500, "ceiling": 1500},
    ],
    ids=["floor", "larger walls", "sparse floor under a ceiling"],
)
def test_finds_the_floor(world, contents, with_people):
    points = room(np.random.default_rng(0), **contents)
    found = find_ground(points, world.true_rig, world.detections if with_people else None)
    assert_is_floor(found, rig=world.true_rig)
    assert (np.abs(points[found.inliers, 2]) < 0.25).all()
    assert found.inliers.sum() > 0.9 * contents["floor"]


def test_evidence_says_what_was_seen(world):
    points = room(np.random.default_rng(1), floor=500, walls=2500, ceiling=2000)
    candidates = find_ground(points, world.true_rig, world.detections).candidates
    faults = [candidate.fault or "" for candidate in candidates]
    assert sum("a wall" in fault for fault in faults) >= 2
    assert any("ceiling" in fault for fault in faults)
    (floor,) = [c for c in candidates if c.fault is None]
    assert floor.cameras_above == 1
    assert floor.feet_ahead > 0.95
    assert np.degrees(floor.tilt) < 5
    assert 2.2 < floor.camera_height < 3.4  # 4.5 to 5 m in units of people of 1.7 m
    assert floor.feet_apart < 0.3


def test_people_on_a_slope_stand_upright(world):
    # The world is turned by 12 degrees but gravity is not, so cameras and people lean.
    turn = Rotation.from_euler("x", 12, degrees=True).as_matrix()
    rng = np.random.default_rng(2)
    points = room(rng, floor=800, walls=0) @ turn.T
    upright = room(rng, floor=0, walls=1200)
    found = find_ground(np.concatenate([points, upright]), world.true_rig, world.detections)
    assert np.linalg.norm(found.plane.normal - turn[:, 2]) < np.radians(1)


def test_a_table_is_not_the_ground(world):
    # It has more points than the floor, is level, and is below the cameras: only feet decide.
    rng = np.random.default_rng(3)
    table = patch(rng, 1500, (-9, -9, 1.0), (18, 0, 0), (0, 18, 0))
    points = np.concatenate([table, room(rng, floor=600, walls=0)])
    assert_is_floor(find_ground(points, world.true_rig, world.detections), rig=world.true_rig)


def test_walls_alone_are_refused_with_reasons(world):
    points = room(np.random.default_rng(4), floor=0, walls=1500, ceiling=800)
    with pytest.raises(GroundRejectedError, match=r"plane 1 .* a wall.*degrees.*known\s+ground"):
        find_ground(points, world.true_rig, world.detections)
    with pytest.raises(GroundRejectedError, match="a wall"):
        find_ground(points, world.true_rig)


def test_a_floor_that_lies_behind_the_feet_is_refused(world):
    # A level plane above half of the cameras.
    height = float(np.median(np.asarray(world.true_rig.centers)[:, 2]))
    points = patch(np.random.default_rng(5), 500, (-9, -9, height), (18, 0, 0), (0, 18, 0))
    with pytest.raises(GroundRejectedError, match="cameras"):
        find_ground(points, world.true_rig, world.detections)


@given(seed=st.integers(0, 2**31 - 1))
@settings(max_examples=8)
def test_similarity_of_the_scene_moves_the_ground(seed):
    small = make_world("ring4", 1, frames=3, people=6, rig_error=NO_ERROR)
    rng = np.random.default_rng(seed)
    points = room(np.random.default_rng(6), floor=300, walls=500)
    with jax.enable_x64(True):
        moved = Similarity(
            np.exp(rng.uniform(-4, 4)),
            Rotation.random(random_state=rng).as_matrix(),
            rng.normal(0, 10, 3),
        )
        here = find_ground(points, small.true_rig, small.detections)
        there = find_ground(
            np.asarray(moved(points)), transform_rig(moved, small.true_rig), small.detections
        )
        expected = transform_plane(moved, here.plane)
    np.testing.assert_allclose(there.plane.normal, expected.normal, atol=1e-6)
    scale = float(moved.scale)
    np.testing.assert_allclose(there.plane.offset / scale, expected.offset / scale, atol=1e-4)
    np.testing.assert_array_equal(here.inliers, there.inliers)


def test_doubtful_and_missing_points_do_not_count(world):
    rng = np.random.default_rng(7)
    good = room(rng, floor=1000, walls=0)
    bad = patch(rng, 1100, (-9, -9, 0.4), (18, 0, 0), (0, 18, 0))
    points = np.concatenate([good, bad, np.full((5, 3), np.nan)])
    confidence = np.concatenate([np.full(len(good), 4.0), np.full(len(bad) + 5, 1.0)])
    found = find_ground(points, world.true_rig, world.detections, confidence=confidence)
    assert_is_floor(found, rig=world.true_rig)
    assert not found.inliers[len(good) :].any()


def test_same_seed_same_ground(world):
    points = room(np.random.default_rng(8), floor=400, walls=800)
    one, two = (find_ground(points, world.true_rig, seed=3).plane for _ in range(2))
    assert one.normal.tolist() == two.normal.tolist()
    assert float(one.offset) == float(two.offset)


def test_points_on_a_line_are_no_ground(world):
    line = np.linspace(0, 1, 50)[:, None] * [5.0, 2, 0]
    with pytest.raises(GroundRejectedError, match="50 scene points coincide or lie on one line"):
        find_ground(line, world.true_rig)
    wall = patch(np.random.default_rng(0), 500, (-12, -12, 0), (24, 0, 0), (0, 0, 8))
    with pytest.raises(GroundRejectedError, match="None of 1 planes"):
        find_ground(np.concatenate([wall, line]), world.true_rig)


def test_too_little_is_refused(world):
    with pytest.raises(InsufficientDataError, match="got 2 points"):
        find_ground(np.zeros((2, 3)), world.true_rig)


@pytest.mark.parametrize("name", ["public_ring5", "public_uneven7", "public_mvx6", "public_gmvd8"])
def test_simulated_clouds_give_their_ground(shared, name):
    from catfree.adapters.datasets._scenario import read_scenario

    sequence = read_scenario(shared / "data/scenarios" / name)
    found = find_ground(sequence.points, sequence.rig, sequence.detections)
    given_plane: Plane = sequence.scene.ground
    angle = np.degrees(np.arccos(np.clip(found.plane.normal @ given_plane.normal, -1, 1)))
    assert angle < 3
    height = np.asarray(given_plane.signed_distance(np.asarray(sequence.rig.centers)))
    found_height = np.asarray(found.plane.signed_distance(np.asarray(sequence.rig.centers)))
    np.testing.assert_allclose(found_height, height, atol=0.03 * float(sequence.scene.extent))
