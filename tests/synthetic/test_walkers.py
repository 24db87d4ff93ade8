import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.errors import InvalidInputError
from catfree.synthetic._crowd_motion import (
    BACKGROUND_BAND,
    ENTRY_MARGIN,
    TOP_ACCELERATION,
    TOP_SPEED,
)
from catfree.synthetic._walkers import (
    ASSUMED_HEIGHT,
    HEIGHT_MEAN_SHIFT,
    simulate_walkers,
)

AREA = (-6.0, 6.0, -9.0, 9.0)
PILLARS = np.array([[0.0, 0.0, 0.4], [3.0, -4.0, 0.6]])


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32 - 1),
    people=st.integers(0, 20),
    background=st.integers(0, 6),
    fps=st.sampled_from([2.0, 5.0, 25.0]),
)
def test_same_seed_gives_the_same_people_bit_for_bit(seed, people, background, fps):
    first, second = (
        simulate_walkers(
            AREA, frames=6, people=people, background=background, fps=fps, seed=seed, stay=10
        )
        for _ in range(2)
    )
    for name, value in vars(first).items():
        np.testing.assert_array_equal(value, getattr(second, name))


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), fps=st.sampled_from([2.0, 5.0, 10.0]))
def test_people_stay_in_the_world_and_move_like_people(seed, fps):
    walkers = simulate_walkers(
        AREA,
        frames=40,
        people=12,
        background=4,
        fps=fps,
        seed=seed,
        stay=10,
        obstacles=PILLARS,
    )
    here = walkers.position[walkers.present]
    # A group's outer member walks up to 1.1 m beside its anchor, and avoidance may add some.
    reach = max(BACKGROUND_BAND[1], ENTRY_MARGIN) + 2.5
    assert (here[:, 0] > AREA[0] - reach).all()
    assert (here[:, 0] < AREA[1] + reach).all()
    assert (here[:, 1] > AREA[2] - reach).all()
    assert (here[:, 1] < AREA[3] + reach).all()
    speed = np.linalg.norm(walkers.velocity, axis=-1)
    assert speed.max() < TOP_SPEED + 1e-6
    both = walkers.present[1:] & walkers.present[:-1]
    step = np.linalg.norm(np.diff(walkers.position, axis=0), axis=-1) * fps
    assert step[both].max() < TOP_SPEED + 1e-6
    jerk = np.linalg.norm(np.diff(walkers.velocity, axis=0), axis=-1) * fps
    assert jerk[both].max() < TOP_ACCELERATION + 1e-6
    for x, y, radius in PILLARS:
        assert np.linalg.norm(here - [x, y], axis=-1).min() > radius + 0.1


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1))
def test_bystanders_never_enter_the_area(seed):
    walkers = simulate_walkers(AREA, frames=60, people=6, background=8, fps=2.0, seed=seed)
    assert walkers.background.sum() == 8
    assert not walkers.inside[:, walkers.background].any()


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1))
def test_mean_height_is_off_the_assumed_one(seed):
    walkers = simulate_walkers(AREA, frames=1, people=800, seed=seed)
    shift = abs(walkers.height.mean() - ASSUMED_HEIGHT)
    error_of_mean = 4 * 0.08 / np.sqrt(800)
    assert HEIGHT_MEAN_SHIFT[0] - error_of_mean < shift < HEIGHT_MEAN_SHIFT[1] + error_of_mean


@pytest.mark.slow
def test_people_enter_leave_stand_and_walk():
    walkers = simulate_walkers(AREA, frames=400, people=15, fps=2.0, seed=3, stay=40)
    appears = walkers.present[1:] & ~walkers.present[:-1]
    vanishes = ~walkers.present[1:] & walkers.present[:-1]
    assert appears.sum() > 20
    assert vanishes.sum() > 20
    # No one appears or vanishes inside the area, or returns under the same identity.
    assert not (appears & walkers.inside[1:]).any()
    assert not (vanishes & walkers.inside[:-1]).any()
    assert (appears.sum(0) <= 1).all()
    assert 10 < walkers.inside.sum(1).mean() < 20
    speed = np.linalg.norm(walkers.velocity, axis=-1)[walkers.present]
    assert 0.1 < (speed < 0.2).mean() < 0.6
    assert 1.0 < np.median(speed[speed > 0.5]) < 1.6


@pytest.mark.slow
def test_nobody_orbits_a_waypoint():
    walkers = simulate_walkers(AREA, frames=600, people=10, fps=10.0, seed=5, stay=1e9, standing=0)
    velocity = walkers.velocity[:, walkers.present.all(0)]
    walks = np.linalg.norm(velocity, axis=-1) > 0.5
    angle = np.unwrap(np.arctan2(velocity[..., 1], velocity[..., 0]), axis=0)
    turned = np.where(walks[1:], np.diff(angle, axis=0), 0.0)
    # Turning without pause in one direction: no ten seconds contain two whole turns.
    window = np.cumsum(turned, axis=0)
    assert np.abs(window[100:] - window[:-100]).max() < 4 * np.pi


@pytest.mark.slow
def test_groups_keep_together():
    walkers = simulate_walkers(AREA, frames=200, people=20, fps=5.0, seed=2, stay=1e9)
    for group in np.unique(walkers.group):
        members = walkers.position[:, walkers.group == group]
        spread = np.linalg.norm(members - members.mean(1, keepdims=True), axis=-1)
        assert np.median(spread) < 1.5


def test_rows_hold_who_is_inside():
    walkers = simulate_walkers(AREA, frames=5, people=4, background=3, seed=1)
    rows = walkers.rows()
    assert len(rows) == walkers.inside.sum()
    frame, person = rows[:, 0].astype(int), rows[:, 1].astype(int)
    np.testing.assert_array_equal(walkers.position[frame, person], rows[:, 2:])
    assert len(walkers.rows(inside_only=False)) == walkers.present.sum()


@pytest.mark.parametrize(
    ("area", "kwargs"),
    [
        ((1.0, 0.0, 0.0, 1.0), {}),
        (AREA, {"frames": 0}),
        (AREA, {"people": -1}),
        (AREA, {"fps": 0.0}),
        (AREA, {"fps": np.nan}),
        (AREA, {"fps": 10**400}),
        (AREA, {"stay": -1}),
        (AREA, {"standing": np.nan}),
        (AREA, {"standing": 2}),
        (AREA, {"standing": -0.1}),
        (AREA, {"standing_time": -1}),
        (AREA, {"seed": -1}),
        (AREA, {"obstacles": np.array([[np.nan, 0.0, 1.0]])}),
        ((np.nan, 1.0, 0.0, 1.0), {}),
        ((-np.inf, 1.0, 0.0, 1.0), {}),
    ],
)
def test_impossible_worlds_are_refused(area, kwargs):
    with pytest.raises(InvalidInputError, match=f"^{next(iter(kwargs), 'area')}.* is "):
        simulate_walkers(area, **({"frames": 2, "people": 3} | kwargs))
