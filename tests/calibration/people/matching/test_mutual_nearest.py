"""Mutually nearest people, compared with all pairs."""

import numpy as np
from hypothesis import given, strategies as st

from catfree.calibration.people.cameras._ground_map import GroundMap
from catfree.calibration.people.matching._mutual_nearest import mutual_nearest


def people(rng: np.random.Generator, frames: int, slots: int, spread: float) -> GroundMap:
    """Draw people on a square of 20 m, some slots empty, some people with the same box."""
    root = rng.normal(0, spread, (frames, slots, 2, 2)) * rng.uniform(0.1, 3, (frames, slots, 1, 1))
    xy = rng.uniform(-10, 10, (frames, slots, 2))
    covariance = root @ np.swapaxes(root, 2, 3) + 0.01 * np.eye(2)
    if slots > 1:
        xy[:, 1], covariance[:, 1] = xy[:, 0], covariance[:, 0]
    valid = rng.random((frames, slots)) < 0.8
    size = np.ones((frames, slots))
    return GroundMap(xy, covariance, 1.7 * size, 0.1 * size, valid)


def of_all_pairs(one: GroundMap, other: GroundMap, gate: float):
    """Return frame, slot, partner, distance and log determinant of mutual matches."""
    for frame in range(len(one.xy)):
        apart = one.xy[frame][:, None] - other.xy[frame]
        covariance = one.covariance[frame][:, None] + other.covariance[frame]
        distance = np.einsum("nmi,nmij,nmj->nm", apart, np.linalg.inv(covariance), apart)
        size = np.linalg.slogdet(covariance)[1]
        valid = one.valid[frame][:, None] & other.valid[frame]
        cost = np.where(valid & (distance < gate), distance + size, np.inf)
        for slot in range(len(cost)):
            partner = cost[slot].argmin()
            if np.isfinite(cost[slot, partner]) and cost[:, partner].argmin() == slot:
                yield frame, slot, partner, distance[slot, partner], size[slot, partner]


@given(
    st.integers(0, 10**6),
    st.integers(1, 4),
    st.integers(1, 9),
    st.integers(1, 9),
    st.sampled_from([0.1, 1.0, 5.0]),
    st.sampled_from([1.0, 9.0, 16.0]),
)
def test_they_are_those_of_all_pairs(seed, frames, slots, partners, spread, gate):
    rng = np.random.default_rng(seed)
    one, other = people(rng, frames, slots, spread), people(rng, frames, partners, spread)
    matches = mutual_nearest(one, other, gate)
    expected = np.array(list(of_all_pairs(one, other, gate)), np.float64).reshape(-1, 5)
    np.testing.assert_array_equal(np.stack(matches[:3], -1), expected[:, :3])
    np.testing.assert_allclose(np.stack(matches[3:], -1), expected[:, 3:], rtol=1e-3, atol=1e-3)


def test_everybody_matches_themselves_and_nobody_far_away():
    rng = np.random.default_rng(0)
    row = GroundMap(
        np.stack([np.arange(12.0).reshape(3, 4), np.zeros((3, 4))], -1),
        np.broadcast_to(0.01 * np.eye(2), (3, 4, 2, 2)),
        np.full((3, 4), 1.7),
        np.full((3, 4), 0.1),
        rng.random((3, 4)) < 0.7,
    )
    matches = mutual_nearest(row, row, 9.0)
    assert len(matches.frame) == row.valid.sum()
    np.testing.assert_array_equal(matches.slot, matches.partner)
    far = GroundMap(row.xy + 50, row.covariance, row.height, row.height_sd, row.valid)
    assert not len(mutual_nearest(row, far, 9.0).frame)


def test_maps_without_slots_have_no_matches():
    rng = np.random.default_rng(0)
    nobody = people(rng, 2, 0, 1.0)
    for one, other in ((nobody, nobody), (nobody, people(rng, 2, 3, 1.0))):
        assert not len(mutual_nearest(one, other, 9.0).frame)
        assert not len(mutual_nearest(other, one, 9.0).frame)
