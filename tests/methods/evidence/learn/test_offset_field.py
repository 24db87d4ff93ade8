"""Offsets of all cameras: the least squares over offsets and people, solved without elimination."""

import numpy as np
from hypothesis import given, strategies as st

from catfree.methods.evidence.learn._offset_field import UNKNOWNS, offset_field

# Index of each edge's four coefficients; the height of a middle has none.
SHARED = np.zeros((3, 4, UNKNOWNS))
for edge, columns in enumerate(((0, 1, 2), (3, 4, 5, 6), (3, 4, 5, 7))):
    SHARED[edge, range(len(columns)), columns] = 1
PRIOR, SPREAD = (0.02, 0.01, 0.03, 0.05), 0.06


def drawn(seed, people=12, cameras=3):
    """Draw arguments of `offset_field`; every camera sees a random two thirds of the people."""
    rng = np.random.default_rng(seed)
    person, camera = np.nonzero(rng.uniform(size=(people, cameras)) < 2 / 3)
    n = len(person)
    weight = rng.uniform(0.1, 2, (n, 3)) * (rng.uniform(size=(n, 3)) < 0.8)
    return {
        "person": person,
        "camera": camera,
        "offset": rng.normal(0, 5, (n, 3)),
        "slopes": rng.normal(0, 50, (n, 3, 3)),
        "features": rng.normal(0, 100, (n, 3, 4)),
        "weight": weight,
        "height": 1 + SPREAD * rng.standard_normal(people),
        "spread": SPREAD,
        "prior": PRIOR,
        "cameras": cameras,
    }


def by_all_unknowns(problem):
    """Solve for the coefficients by one dense system of offsets, positions and heights."""
    person, camera, weight = problem["person"], problem["camera"], problem["weight"]
    people, size = len(problem["height"]), UNKNOWNS * problem["cameras"]
    rows, targets = [], []
    for i, (p, c) in enumerate(zip(person, camera, strict=True)):
        for k in range(3):
            row = np.zeros(size + 3 * people)
            row[UNKNOWNS * c : UNKNOWNS * (c + 1)] = problem["features"][i, k] @ SHARED[k]
            row[size + 3 * p : size + 3 * (p + 1)] = problem["slopes"][i, k]
            rows.append(row * weight[i, k] ** 0.5)
            targets.append(problem["offset"][i, k] * weight[i, k] ** 0.5)
    deviation = np.tile([*PRIOR[:3], *PRIOR[:3], PRIOR[3], PRIOR[3]], problem["cameras"])
    rows += list(np.eye(size, size + 3 * people) / deviation[:, None])
    targets += [0.0] * size
    for p, height in enumerate(problem["height"]):
        rows.append(np.eye(1, size + 3 * people, size + 3 * p + 2)[0] / SPREAD)
        targets.append((1 - height) / SPREAD)
    found = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0][:size]
    return np.einsum("cs,kfs->ckf", found.reshape(-1, UNKNOWNS), SHARED)


@given(st.integers(0, 10**6))
def test_elimination_gives_what_all_unknowns_together_give(seed):
    problem = drawn(seed)
    expected = by_all_unknowns(problem)
    np.testing.assert_allclose(offset_field(**problem), expected, rtol=1e-4, atol=1e-6)


@given(st.integers(0, 10**6))
def test_people_who_only_moved_leave_the_cameras_alone(seed):
    problem = drawn(seed)
    moved = np.random.default_rng(seed).normal(0, 0.3, (len(problem["height"]), 3))
    moved[:, 2] = 1 - problem["height"]  # to the mean height, at no cost
    problem["weight"] = np.ones_like(problem["weight"])
    problem["offset"] = np.einsum("nki,ni->nk", problem["slopes"], moved[problem["person"]])
    np.testing.assert_allclose(offset_field(**problem), 0, atol=1e-6)


@given(st.integers(0, 10**6), st.permutations(range(3)))
def test_cameras_may_have_any_order(seed, order):
    problem = drawn(seed)
    found = offset_field(**problem)
    problem["camera"] = np.argsort(order)[problem["camera"]]
    np.testing.assert_allclose(offset_field(**problem), found[list(order)], rtol=1e-6, atol=1e-9)


def test_a_camera_without_boxes_has_no_offsets():
    problem = drawn(0) | {"cameras": 4}
    found = offset_field(**problem)
    assert (found[3] == 0).all()
    np.testing.assert_allclose(found[:3], offset_field(**drawn(0)))
    nobody = {
        name: value[:0] if isinstance(value, np.ndarray) else value
        for name, value in problem.items()
    }
    assert (offset_field(**nobody) == 0).all()


def test_the_ends_of_boxes_share_what_a_pose_explains():
    found = offset_field(**drawn(1))
    np.testing.assert_array_equal(found[:, 1, :3], found[:, 2, :3])
    assert (found[:, 1, 3] != found[:, 2, 3]).all()
    assert (found[:, 0, 3] == 0).all()
