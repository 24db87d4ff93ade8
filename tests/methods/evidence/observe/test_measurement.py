"""A box as a Gaussian likelihood: correct place, as sharp as its edges, or flat."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.geometry._person import box_edges
from catfree.methods.evidence._gaussian import mean_and_covariance
from catfree.methods.evidence.observe._measurement import (
    Box,
    BoxConstants,
    Measurements,
    implied_person,
    measure_all,
    start_noise,
)
from catfree.methods.evidence.observe._views import ground_views
from catfree.settings import EvidenceSettings
from catfree.settings._calibration_settings import FOOT_AHEAD
from tests.methods.evidence.evidence_worlds import HEIGHT, make_rig, make_scene

RULES = EvidenceSettings()
CAMERAS = 5
VIEWS = ground_views(make_scene(make_rig(CAMERAS, roll=0.15)), HEIGHT)
SIDE, TOP, BOTTOM = range(3)


def shown(camera, state):
    """Return the exact boxes of people."""
    return box_edges(VIEWS.matrix[camera], state, VIEWS.station[camera], FOOT_AHEAD)


pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("x64")]


@dataclasses.dataclass
class Rows:
    """Make arguments of `measure_all`: uncut, unhidden and present boxes unless changed."""

    edges: np.ndarray
    camera: np.ndarray

    def __post_init__(self):
        n = len(self.edges)
        self.size = self.edges[:, BOTTOM] - self.edges[:, TOP]
        self.cut = np.zeros((n, 3), bool)
        self.ankles = np.ones(n, bool)
        self.covered = np.zeros(n)
        self.present = np.ones(n, bool)

    def take(self, order):
        out = Rows(self.edges[order], self.camera[order])
        for name in ("size", "cut", "ankles", "covered", "present"):
            setattr(out, name, getattr(self, name)[order])
        return out

    def measured(self, noise=None, rules=RULES) -> Measurements:
        noise = start_noise(CAMERAS, rules) if noise is None else noise
        boxes = Box(self.edges, self.size, self.cut, self.ankles, self.covered)
        constants = BoxConstants.of(rules)
        found = measure_all(boxes, self.camera, self.camera, self.present, VIEWS, noise, constants)
        return jax.tree.map(np.asarray, found)


def place_of(found):
    """Return position, height and covariance implied by each box alone."""
    return mean_and_covariance(found.info, SPREAD)


def people(seed, count=12):
    """Draw states of people around the middle and their exact boxes, in one camera each."""
    rng = np.random.default_rng(seed)
    state = np.column_stack([rng.uniform(-2, 2, (count, 2)), np.ones(count)])
    camera = rng.integers(0, CAMERAS, count)
    return state, Rows(shown(camera, state), camera)


def disturbed(seed):
    """Make boxes with the usual noise."""
    _, rows = people(seed)
    noise = np.array(RULES.edge_noise) * rows.size[:, None]
    rows.edges = rows.edges + 0.7 * noise * np.random.default_rng(seed).standard_normal((12, 3))
    return rows


SPREAD = float(np.sqrt(np.prod(RULES.height_spread_range)))  # as in `start_noise`
seeds = st.integers(0, 10**6)
implied_people = jax.jit(jax.vmap(implied_person))


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_feet_and_height_that_a_box_in_a_rolled_camera_implies(seed):
    # The foot is a sixth of the height beside the box center there; two rounds leave the square.
    state, rows = people(seed)
    known = VIEWS.matrix, VIEWS.ground_inverse, VIEWS.station
    cameras = (np.asarray(part)[rows.camera] for part in known)
    position, height = implied_people(*cameras, rows.edges)
    np.testing.assert_allclose(height, state[:, 2], atol=0.02)
    np.testing.assert_allclose(position, state[:, :2], atol=0.02)


@given(seeds)
def test_an_exact_box_is_a_person_of_usual_height_where_they_stand(seed):
    state, rows = people(seed)
    found = rows.measured()
    assert found.valid.all()
    np.testing.assert_allclose(place_of(found)[0], state, atol=1e-9)


@given(seeds)
def test_the_likelihood_is_that_of_the_edges_about_the_most_likely_person(seed):
    found = (rows := disturbed(seed)).measured()
    precision = np.where(found.used, found.noise**-2.0, 0)
    edges = lambda s: shown(rows.camera, s)  # noqa: E731
    state = place_of(found)[0]
    step = 1e-6
    slopes = np.stack(
        [(edges(state + d) - edges(state - d)) / (2 * step) for d in step * np.eye(3)],
        -1,
    )
    for i in np.flatnonzero(found.valid):
        s, J, W = state[i], slopes[i], np.diag(precision[i])
        away = rows.edges[i] - edges(state)[i]
        matrix, b, k = found.info.matrix[i], found.info.vector[i], found.info.constant[i]
        size = np.trace(matrix)
        np.testing.assert_allclose(matrix, J.T @ W @ J, rtol=1e-5, atol=1e-6 * size)
        # The form has the value and gradient of the sum of squares there.
        assert s @ matrix @ s - 2 * b @ s + k == pytest.approx(away @ W @ away, abs=1e-6)
        np.testing.assert_allclose(b - matrix @ s, J.T @ W @ away, rtol=1e-4, atol=1e-5 * size)
        # Gauss-Newton has converged.
        usual, prior = np.array([0, 0, 1.0]), np.diag([0, 0, SPREAD**-2])
        step_left = np.linalg.solve(J.T @ W @ J + prior, J.T @ W @ away + prior @ (usual - s))
        np.testing.assert_allclose(step_left, 0, atol=1e-6)


@pytest.mark.parametrize("edge", [TOP, BOTTOM])
@given(seeds, st.floats(-80, 80))
def test_an_edge_that_the_border_cuts_says_nothing(edge, seed, error):
    _, rows = people(seed)
    rows.cut[:, edge] = True
    plain = rows.measured()
    rows.edges[:, edge] += error
    wrong = rows.measured()
    assert not plain.used[:, edge].any()
    for one, other in zip(jax.tree.leaves(plain.info), jax.tree.leaves(wrong.info), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-6)
    np.testing.assert_array_equal(plain.valid, wrong.valid)


def test_a_box_without_feet_and_head_is_no_measurement():
    _, rows = people(0)
    rows.cut[:6, TOP] = rows.cut[:6, BOTTOM] = True
    vague = dataclasses.replace(RULES, largest_sigma=1e9)
    for rules in (RULES, vague):
        np.testing.assert_array_equal(rows.measured(rules=rules).valid, np.arange(12) >= 6)


def area(found):
    return np.linalg.det(place_of(found)[1][:, :2, :2])


@given(seeds, st.floats(0, 1), st.floats(0, 1))
def test_hidden_feet_and_unseen_ankles_are_vaguer(seed, one, other):
    _, rows = people(seed)
    less, more = (rows.take(np.arange(12)) for _ in range(2))
    less.covered[:], more.covered[:] = min(one, other), max(one, other)
    assert (area(more.measured()) >= area(less.measured()) * (1 - 1e-9)).all()
    unseen = rows.take(np.arange(12))
    unseen.ankles[:] = False
    assert (area(unseen.measured()) > area(rows.measured())).all()
    few = rows.take(np.arange(12))
    few.cut[:, SIDE] = True
    assert (area(few.measured()) > area(rows.measured())).all()


@given(seeds, st.permutations(range(12)))
def test_every_box_is_measured_on_its_own(seed, order):
    rows = disturbed(seed)
    together, mixed = rows.measured(), rows.take(np.array(order)).measured()
    for all_, some in zip(jax.tree.leaves(together), jax.tree.leaves(mixed), strict=True):
        np.testing.assert_array_equal(all_[np.array(order)], some)


@given(seeds, st.sampled_from([np.nan, np.inf, 0.0, -1e9, 1e9]))
def test_an_absent_row_may_hold_anything_and_counts_nothing(seed, junk):
    rows = disturbed(seed)
    plain = rows.measured()
    absent = np.arange(12) % 3 == 0
    rows.edges[absent], rows.size[absent], rows.present[absent] = junk, junk, False
    found = rows.measured()
    assert not found.valid[absent].any()
    for before, after in zip(*(jax.tree.leaves(m.info) for m in (plain, found)), strict=True):
        assert (after[absent] == 0).all()
        np.testing.assert_array_equal(after[~absent], before[~absent])


@settings(max_examples=50)
@given(seeds)
def test_boxes_of_nobody_on_the_ground_are_finite_and_bounded(seed):
    edges = np.random.default_rng(seed).uniform(-3000, 3000, (12, 3))
    rows = Rows(edges, np.arange(12) % CAMERAS)
    rows.size = np.maximum(rows.size, 1.0)  # bounded as in `prepare_boxes`
    found = rows.measured()
    for leaf in jax.tree.leaves(found.info):
        assert np.isfinite(leaf).all()
    assert (found.info.matrix[~found.valid] == 0).all()
    there = mean_and_covariance(found.info[found.valid], SPREAD)[1][:, :2, :2]
    assert (np.linalg.eigvalsh(there) > 0).all()
    sigma = np.sqrt((there[:, 0, 0] + there[:, 1, 1]) / 2)
    assert (sigma < RULES.largest_sigma).all()


@given(seeds, st.integers(0, CAMERAS - 1), st.floats(-0.01, 0.01))
def test_a_learned_offset_is_taken_off_its_own_camera_only(seed, camera, offset):
    state, rows = people(seed)
    noise = start_noise(CAMERAS, RULES)
    field = noise.field.copy()
    field[camera, :, 0] = offset  # radians, the same for every edge
    mine = rows.camera == camera
    shifted = rows.take(np.arange(12))
    shifted.edges[mine] += offset * VIEWS.focal[camera]
    found = shifted.measured(eqx.tree_at(lambda n: n.field, noise, field))
    np.testing.assert_allclose(place_of(found)[0], state, atol=1e-9)
