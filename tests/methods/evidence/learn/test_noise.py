"""Self-calibration from known groups: it finds the drawn noise, offsets and heights."""

import dataclasses
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from catfree.geometry._person import box_edges
from catfree.methods.evidence._gaussian import Information
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.learn._noise import crowding, learn_noise, median_height
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._measurement import measure_boxes, start_noise
from catfree.methods.evidence.observe._views import ground_views
from catfree.settings import EvidenceSettings
from tests.methods.evidence.evidence_worlds import HEIGHT, bare_boxes, make_rig, make_scene

CAMERAS, PEOPLE = 6, 400
VIEWS = ground_views(make_scene(make_rig(CAMERAS)), HEIGHT)
# No calibration errors, so only the noise of the edges remains.
RULES = EvidenceSettings(angular_noise=1e-4, angular_noise_range=(1e-4, 1e-4))

pytestmark = pytest.mark.usefixtures("x64")


@dataclasses.dataclass
class Crowd:
    """People in the middle, and their boxes in every camera, in the same order."""

    edges: np.ndarray  # (P, C, 3)
    views: object = VIEWS

    @property
    def member(self):
        return np.arange(self.edges.shape[0] * CAMERAS).reshape(-1, CAMERAS)

    @property
    def boxes(self) -> Boxes:
        frame, camera = np.indices(self.edges.shape[:2]).reshape(2, -1)
        edges = self.edges.reshape(-1, 3)
        size = edges[:, 2] - edges[:, 1]
        half = 0.2 * size
        box = np.column_stack([edges[:, 0] - half, edges[:, 1], edges[:, 0] + half, edges[:, 2]])
        return bare_boxes(frame, camera, self.member[..., None], box=box, edges=edges)

    def learned(self, rounds=6, rules=RULES):
        """Return the noise after these rounds, and the last median height."""
        boxes, member, ratio = self.boxes, self.member, 1.0
        noise = start_noise(CAMERAS, rules)
        for _ in range(rounds):
            measured = measure_boxes(boxes, self.views, noise, rules)
            own = measured.info
            info = Information(
                own.matrix[member].sum(1), own.vector[member].sum(1), own.constant[member].sum(1)
            )
            H = len(member)
            frame = np.arange(H)
            groups = Groups(frame, member, info, np.zeros(H))
            noise, ratio = learn_noise(noise, groups, measured, boxes, self.views, rules)
        return noise, ratio


@cache
def exact(spread=0.05, people=PEOPLE):
    """Draw (P, C, 3) edges of people with this spread of heights."""
    rng = np.random.default_rng(0)
    place = rng.uniform(-1.2, 1.2, (people, 2))
    state = np.column_stack([place, 1 + spread * rng.standard_normal(people)])
    cameras = jax.vmap(box_edges, in_axes=(0, None, 0, None))
    people = jax.vmap(cameras, in_axes=(None, 0, None, None))
    with jax.enable_x64(True):
        return np.asarray(
            people(jnp.asarray(VIEWS.matrix), jnp.asarray(state), jnp.asarray(VIEWS.station), 0.0)
        )


def noisy(seed, share, edges=None):
    """Make boxes whose edges are off by (C, 3) fractions of their height."""
    edges = exact() if edges is None else edges
    size = (edges[..., 2] - edges[..., 1])[..., None]
    return Crowd(edges + share * size * np.random.default_rng(seed).standard_normal(edges.shape))


@pytest.mark.slow
@settings(max_examples=8)
@given(st.integers(0, 10**6), st.floats(0.8, 2.0), st.floats(0.8, 2.0))
def test_the_noise_of_each_cameras_columns_is_found(seed, factor, other):
    share = np.outer([factor, *[other] * (CAMERAS - 1)], RULES.edge_noise)
    noise, ratio = noisy(seed, share).learned()
    # Four deviations of a deviation from the MAD, whose efficiency is 0.37 for 400 residuals.
    np.testing.assert_allclose(noise.edge[:, 0], share[:, 0], rtol=4 / np.sqrt(2 * 0.37 * PEOPLE))
    # The median of 400 heights, each from six cameras, is known to half a percent.
    assert ratio == pytest.approx(1, abs=0.02)


@pytest.mark.slow
@settings(max_examples=8)
@given(st.integers(0, 10**6), st.integers(0, CAMERAS - 1), st.integers(0, 2))
def test_an_edge_that_is_twice_as_noisy_in_one_camera_is_told_there(seed, camera, edge):
    share = np.array([RULES.edge_noise] * CAMERAS)
    share[camera, edge] *= 2
    noise, _ = noisy(seed, share).learned()
    factor = noise.edge / RULES.edge_noise
    assert np.unravel_index(factor.argmax(), factor.shape) == (camera, edge)
    assert factor[camera, edge] > 1.4 * np.delete(factor[:, edge], camera).max()


@pytest.mark.slow
@settings(max_examples=8)
@given(st.integers(0, 10**6), st.integers(0, CAMERAS - 1), st.floats(-0.01, 0.01))
def test_the_offset_of_one_camera_is_found(seed, camera, angle):
    crowd = noisy(seed, np.array([RULES.edge_noise] * CAMERAS))
    crowd.edges[:, camera] += angle * VIEWS.focal[camera]
    noise, _ = crowd.learned()

    def usual(camera):
        """Compute the mean offset of each edge in that camera's boxes, in radians."""
        edges = crowd.edges[:, camera]
        rows = np.column_stack([edges[:, 1:].mean(1), edges[:, 1], edges[:, 2]])
        size = (edges[:, 2] - edges[:, 1])[:, None] * np.array([0, 1, 1])
        away = edges[:, :1] - VIEWS.center[camera, 0]
        focal = np.full_like(rows, VIEWS.focal[camera])
        features = [focal, away + 0 * rows, rows - VIEWS.center[camera, 1], size]
        return (np.stack(features, -1) * noise.field[camera]).sum(-1).mean(0) / focal[0, 0]

    found = np.array([usual(c) for c in range(CAMERAS)])
    drawn = np.zeros((CAMERAS, 3))
    drawn[camera] = angle
    # A turn of the map moves all columns equally, and a shift moves each by the camera's direction:
    # the part that these explain cannot be determined.
    modes = np.column_stack([np.ones(CAMERAS), VIEWS.heading])
    seen = np.eye(CAMERAS) - modes @ np.linalg.pinv(modes)
    # The mean noise of 400 boxes of 0.2 radians is half a milliradian.
    np.testing.assert_allclose(seen @ found[:, 0], seen @ drawn[:, 0], atol=0.002)
    still = crowd.learned(rules=dataclasses.replace(RULES, residual_field=False))[0]
    assert (still.field == 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("sides", [(1,), (-1, 1)])
def test_people_far_from_where_a_camera_puts_them_hardly_make_it_noisier(sides):
    share = np.array([RULES.edge_noise] * CAMERAS)
    crowd = noisy(0, share)
    plain, _ = crowd.learned()
    rng = np.random.default_rng(1)
    wrong = rng.random(PEOPLE) < 0.1
    # Pixels: about two people's width, ten deviations.
    crowd.edges[wrong, 0, 0] += 80.0 * rng.choice(sides, wrong.sum())
    noise, _ = crowd.learned()
    grown = noise.edge[0, 0] / plain.edge[0, 0]
    # A tenth of outliers increases the MAD by a seventh, and a deviation by a factor of three. If
    # all are on one side they also shift the learned offset, so it grows more, but by less than
    # half.
    if len(sides) == 2:
        assert grown == pytest.approx(1.14, rel=0.1)
    assert grown < 3 / 2


@pytest.mark.slow
@pytest.mark.parametrize("unit", [0.8, 1.3])
def test_a_wrong_unit_is_set_right_by_the_median_height(unit):
    views = ground_views(make_scene(make_rig(CAMERAS)), HEIGHT * unit)
    crowd = Crowd(exact(), views)
    assert median_height(crowd.boxes, views) == pytest.approx(1 / unit, rel=0.01)
    empty = dataclasses.replace(crowd.boxes, valid=np.zeros(PEOPLE * CAMERAS, bool))
    assert np.isnan(median_height(empty, views))
    cut = dataclasses.replace(crowd.boxes, cut=np.ones((PEOPLE * CAMERAS, 3), bool))
    assert np.isnan(median_height(cut, views))


@pytest.mark.slow
@settings(max_examples=6)
@given(st.integers(0, 1000), st.sampled_from([0.05, 0.0625, 0.08, 0.1]), st.floats(0.75, 1.5))
def test_the_spread_of_heights_is_found(seed, spread, factor):
    # Heights estimated with a prior are closer together than true heights, the more so the noisier
    # the boxes. If all stand equally far, an offset by box height would explain heights.
    rules = dataclasses.replace(RULES, residual_field=False)
    edges = exact(spread)
    found = noisy(seed, factor * np.array(RULES.edge_noise), edges).learned(rules=rules)[0]
    rng = np.random.default_rng(0)
    rng.uniform(size=(PEOPLE, 2))
    height = spread * rng.standard_normal(PEOPLE)  # as drawn
    drawn = 1.4826 * np.median(np.abs(height - np.median(height)))
    assert float(found.spread) == pytest.approx(drawn, rel=0.08)


@pytest.mark.slow
def test_from_few_people_nothing_is_learned():
    few = Crowd(exact()[:9])
    noise, ratio = few.learned(rounds=1)
    assert ratio == 1
    assert eqx.tree_equal(noise, start_noise(CAMERAS, RULES))


@pytest.mark.slow
@settings(max_examples=5)
@given(st.integers(0, 10**6))
def test_the_order_of_the_people_says_nothing(seed):
    share = np.array([RULES.edge_noise] * CAMERAS)
    crowd = noisy(seed, share)
    order = np.random.default_rng(seed).permutation(PEOPLE)
    for one, other in zip(
        jax.tree.leaves(crowd.learned(2)), jax.tree.leaves(Crowd(crowd.edges[order]).learned(2)),
        strict=True,
    ):  # fmt: skip
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
@given(st.integers(0, 10**6), st.integers(1, 60), st.integers(1, 4))
def test_crowding_is_people_over_the_ground_that_they_use(seed, people, frames):
    rng = np.random.default_rng(seed)
    place = rng.uniform(-9, 9, (people, 2))
    found = crowding(np.tile(place, (frames, 1)), np.repeat(np.arange(frames), people))
    # The ground within a step of any person, by Monte Carlo.
    points = rng.uniform(-11, 11, (40000, 2))
    distance = np.hypot(*np.moveaxis(points[:, None] - place, -1, 0)).min(1)
    used = (distance < 2 / np.sqrt(np.pi)).mean()
    noise = 4 * np.sqrt((1 - used) / used / len(points))  # deviations of the Monte Carlo
    ellipse = 4 * np.pi * np.sqrt(np.linalg.det(np.cov(place.T, bias=True))) if people > 2 else 0
    assert found == pytest.approx(people / max(used * 22**2, ellipse), rel=noise + 0.04)
    order = rng.permutation(people)
    assert crowding(place[order], np.zeros(people, int)) == pytest.approx(found, rel=1e-9)


@given(st.integers(0, 10**6), st.floats(2, 30), st.floats(2, 30), st.floats(-3, 3))
def test_crowding_of_one_frame_is_that_of_the_ellipse_it_fills(seed, long, wide, turn):
    rng = np.random.default_rng(seed)
    distance, angle = np.sqrt(rng.random(4000)), rng.uniform(0, 2 * np.pi, 4000)
    even = distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1) * [long, wide]
    place = even @ Rotation.from_euler("z", turn).as_matrix()[:2, :2]
    few = place[:8]  # too few to have been everywhere
    area = 4 * np.pi * np.sqrt(np.linalg.det(np.cov(few.T, bias=True)))
    assert crowding(few, np.zeros(8, int)) <= 8 / area * (1 + 1e-9)
    assert 4 * np.pi * np.sqrt(np.linalg.det(np.cov(place.T))) == pytest.approx(
        np.pi * long * wide, rel=0.1
    )
