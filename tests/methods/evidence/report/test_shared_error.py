"""Pose errors move all people together, and the stated errors must match the real ones."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from catfree.geometry._person import box_edges
from catfree.methods.evidence import solve
from catfree.methods.evidence.report._shared_error import (
    map_modes,
    mode_sums,
    offset_scatter,
    scatter_between,
    shared_covariance,
)
from catfree.settings import EvidenceSettings
from catfree.synthetic import RigError, make_world
from tests.methods.evidence.evidence_worlds import (
    make_rig,
    make_scene,
    state_of_boxes,
    walk,
)

SETTINGS = EvidenceSettings()


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01))
def test_modes_are_shift_turn_and_scale_about_the_middle(x, y, turn, scale):
    state, middle = np.array([[x, y, 1.1]]), np.array([0.3, -0.2])
    moved = state[0] + map_modes(state, middle)[0] @ [0.02, -0.01, turn, scale]
    c, s = np.cos(turn), np.sin(turn)
    around = np.exp(scale) * np.array([[c, -s], [s, c]]) @ (state[0, :2] - middle) + middle
    np.testing.assert_allclose(moved[:2], around + np.array([0.02, -0.01]), atol=2e-3)
    assert moved[2] == pytest.approx(1.1 * np.exp(scale), abs=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_sums_predict_how_offsets_of_cameras_move_the_map():
    rng = np.random.default_rng(0)
    boxes = state_of_boxes(make_scene(make_rig()), np.tile(np.arange(5), 9), 4)
    views = boxes.views
    state = np.column_stack([rng.uniform(-2, 2, (9, 2)), np.ones(9)])
    modes = map_modes(state, state[:, :2].mean(0))
    member = np.arange(45).reshape(9, 5)
    normal, lever = mode_sums(state, modes, member, boxes)
    offset = 1e-4 * rng.standard_normal((5, 3))
    predicted = np.linalg.solve(normal, (lever @ offset[..., None])[..., 0].sum(0))

    @jax.jit
    def edges(g):
        there = jnp.asarray(state) + jnp.asarray(modes) @ g
        of_camera = jax.vmap(box_edges, (None, 0, None, None))
        return jax.vmap(of_camera, (0, None, 0, None))(
            jnp.asarray(views.matrix), there, jnp.asarray(views.station), 0.0
        )

    slopes = jax.jit(jax.jacfwd(edges))
    target = np.asarray(edges(jnp.zeros(4))) + (offset * views.focal[:, None])[:, None]
    g = np.zeros(4)
    for _ in range(5):
        J = np.asarray(slopes(jnp.asarray(g))).reshape(-1, 4)
        g += np.linalg.lstsq(J, (target - np.asarray(edges(jnp.asarray(g)))).ravel(), rcond=None)[0]
    np.testing.assert_allclose(predicted, g, rtol=0.02, atol=1e-6)


def solved(error):
    world = make_world("ring6", 5, frames=12, people=10, rig_error=error)
    return solve(world.detections, world.scene)


def added(s):
    with jax.enable_x64(True):
        return shared_covariance(s, SETTINGS)


@pytest.mark.slow
def test_a_worse_rig_is_less_sure_and_a_good_one_as_sure_as_before():
    good, bad = (solved(e) for e in (RigError(0, 0, 0, 0, 0), RigError()))
    sigma = [np.sqrt(np.trace(added(s)[s.kept], axis1=1, axis2=2) / 2) for s in (good, bad)]
    assert np.median(sigma[0]) < 0.01 < 0.02 < np.median(sigma[1]) < 0.15
    for s in (good, bad):
        assert (np.linalg.eigvalsh(added(s)) > -1e-12).all()
        own = s.trails.covariance[:, :2, :2]
        assert (np.linalg.eigvalsh(s.position_covariance - added(s) - own) > 0).all()


@pytest.mark.slow
def test_what_all_cameras_have_in_common_is_no_error_of_a_pose():
    _, detections, scene = walk(frames=6, seed=3)
    s = solve(detections, scene)
    member = s.groups.member[s.trails.group[s.kept & (s.trails.group >= 0)]]
    field = np.zeros_like(s.noise.field)
    field[:, :, 0] = [0.01, -0.02, 0.005]  # the same angles in every camera
    with jax.enable_x64(True):
        scatter, nothing = (
            offset_scatter(member, replace(s, noise=replace(s.noise, field=value)), SETTINGS)
            for value in (field, 0 * field)
        )
    assert scatter is not None
    none = scatter_between(np.zeros((len(field), 3)), SETTINGS.angular_noise)
    np.testing.assert_allclose(scatter, none, atol=1e-12)
    assert nothing is None


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3, 4, 5, 7, 12])
def test_what_few_cameras_have_in_common_strays_as_often_as_stated(count):
    rng = np.random.default_rng(count)
    # The prior: variances about the assumed one, as uncertain as from a single draw.
    spread = 0.003 / np.sqrt(rng.chisquare(1, 10_000))
    offsets = spread[:, None, None] * rng.standard_normal((10_000, count, 3))
    stated = [np.diag(scatter_between(each, 0.003)) / count for each in offsets]
    inside = np.abs(offsets.mean(1)) < 1.96 * np.sqrt(stated)
    assert inside.mean() == pytest.approx(0.95, abs=0.006)


@given(
    offsets=arrays(
        np.float64, st.tuples(st.integers(1, 12), st.just(3)), elements=st.floats(-1, 1)
    ),
    common=st.floats(-1, 1),
    factor=st.floats(0.1, 10),
)
def test_scatter_ignores_what_is_common_and_follows_the_unit(offsets, common, factor):
    scatter = scatter_between(offsets, 0.01)
    np.testing.assert_allclose(scatter_between(offsets + common, 0.01), scatter, atol=1e-12)
    np.testing.assert_allclose(
        scatter_between(offsets * factor, 0.01 * factor), scatter * factor**2, rtol=1e-6, atol=1e-15
    )
    np.testing.assert_allclose(scatter_between(offsets[::-1], 0.01), scatter, atol=1e-12)
    assert (np.linalg.eigvalsh(scatter) > 0).all()


def test_scatter_of_many_cameras_is_their_variance():
    offsets = np.random.default_rng(0).normal(0, [0.01, 0.02, 0.03], (4000, 3))
    np.testing.assert_allclose(np.diag(scatter_between(offsets, 0.003)), offsets.var(0), rtol=2e-3)
