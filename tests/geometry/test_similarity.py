"""Similarity transforms: group laws, Umeyama's fit against references, scenes in a moved world."""

import inspect
import json
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from catfree import Plane, Rig, Scene, geometry
from catfree.errors import DegenerateGeometryError, InvalidInputError
from catfree.geometry import Similarity

points = hnp.arrays(np.float64, (5, 3), elements=st.floats(-10, 10))
noises = hnp.arrays(np.float64, (5, 3), elements=st.floats(-0.5, 0.5))


@st.composite
def similarities(draw):
    motion = draw(hnp.arrays(np.float64, 6, elements=st.floats(-3, 3)))
    scale = 10 ** draw(st.floats(-2, 2))
    return scale, Rotation.from_rotvec(motion[:3]).as_matrix(), motion[3:]


def fit_flat(source, target, weights):
    found = geometry.fit_similarity(source, target, weights)
    return jnp.concatenate([found.scale[None], found.rotation.ravel(), found.translation])


project = jax.jit(geometry.project)
fit_value = jax.jit(fit_flat)
fit_reverse = jax.jit(jax.jacrev(fit_flat, (0, 1, 2)))
fit_forward = jax.jit(jax.jacfwd(fit_flat, (0, 1, 2)))


def in_general_position(cloud, least=0.5):
    assume(np.linalg.svd(cloud - cloud.mean(0), compute_uv=False)[1] > least)


@pytest.mark.slow
@given(similarities(), similarities(), points)
def test_group_laws(x64, a, b, cloud):
    a, b = Similarity(*a), Similarity(*b)
    size = 1e-9 * float(a.scale * b.scale + a.scale + b.scale + 1) * 100
    np.testing.assert_allclose((a @ b)(cloud), a(b(cloud)), atol=size)
    np.testing.assert_allclose(a.inverse()(a(cloud)), cloud, atol=1e-9)
    np.testing.assert_allclose(a(a.inverse()(cloud)), cloud, atol=1e-9)
    np.testing.assert_allclose(Similarity.identity()(cloud), cloud, atol=1e-300)


@pytest.mark.slow
@given(similarities(), points)
def test_fit_recovers_an_exact_similarity(x64, truth, cloud):
    in_general_position(cloud)
    truth = Similarity(*truth)
    found = geometry.fit_similarity(cloud, truth(cloud))
    np.testing.assert_allclose(found.scale, truth.scale, rtol=1e-9)
    np.testing.assert_allclose(found.rotation, truth.rotation, atol=1e-8)
    np.testing.assert_allclose(found(cloud), truth(cloud), atol=1e-8 * float(truth.scale))


@pytest.mark.slow
@given(similarities(), points, noises)
def test_fit_is_equivariant_in_both_frames(x64, move, cloud, noise):
    target = cloud + noise
    in_general_position(cloud, 2)
    in_general_position(target, 2)
    values = np.linalg.svd((target - target.mean(0)).T @ (cloud - cloud.mean(0)))[1]
    assume(values[1] > 1)
    move = Similarity(*move)
    expected = geometry.fit_similarity(cloud, target)(cloud)
    found = geometry.fit_similarity(move(cloud), target)(move(cloud))
    np.testing.assert_allclose(found, expected, atol=1e-7)
    after = geometry.fit_similarity(cloud, move(target))(cloud)
    np.testing.assert_allclose(after, move(expected), atol=1e-7 * float(move.scale))


@pytest.mark.slow
@given(points, noises, hnp.arrays(np.float64, 6, elements=st.floats(-0.1, 0.1)), st.booleans())
def test_no_nearby_similarity_fits_better(x64, cloud, noise, nudge, fixed_scale):
    in_general_position(cloud)
    target = cloud + noise
    weights = np.array([1.0, 0.5, 2, 1, 1])
    found = geometry.fit_similarity(cloud, target, weights, fixed_scale=fixed_scale)
    turned = np.asarray(found.rotation) @ Rotation.from_rotvec(nudge[:3]).as_matrix()
    stretch = 1.0 if fixed_scale else 1 + nudge[0]
    other = Similarity(found.scale * stretch, turned, found.translation + nudge[3:])

    def cost(transform):
        return weights @ np.sum((np.asarray(transform(cloud)) - target) ** 2, axis=1)

    assert cost(found) <= cost(other) + 1e-10
    np.testing.assert_allclose(np.linalg.det(found.rotation), 1, atol=1e-10)
    if fixed_scale:
        assert found.scale == 1


@pytest.mark.slow
@given(points, noises)
def test_derivatives_agree_with_finite_differences_in_both_modes(x64, cloud, noise):
    target = cloud + noise
    offsets = cloud - cloud.mean(0)
    values = np.linalg.svd((target - target.mean(0)).T @ offsets)[1]
    assume(values[1] - values[2] > 1)
    arguments = [cloud, target, np.ones(5)]
    reverse, forward = fit_reverse(*arguments), fit_forward(*arguments)
    size = 1e-6
    for argument in range(3):
        np.testing.assert_allclose(forward[argument], reverse[argument], atol=1e-8)
        for index in np.ndindex(arguments[argument].shape):
            sides = []
            for step in (size, -size):
                moved = [a.copy() for a in arguments]
                moved[argument][index] += step
                sides.append(np.asarray(fit_value(*moved)))
            slope = (sides[0] - sides[1]) / (2 * size)
            at = (slice(None), *index)
            np.testing.assert_allclose(
                reverse[argument][at], slope, atol=1e-5 * (1 + np.abs(slope).max())
            )


@pytest.mark.slow
@given(points)
def test_absent_pairs_do_not_count(x64, cloud):
    in_general_position(cloud)
    weights = np.append(np.ones(5), 0.0)
    padded = np.concatenate([cloud, np.full((1, 3), np.nan)])
    found = geometry.fit_similarity(padded, 2 * padded, weights)
    np.testing.assert_allclose(found.scale, 2)
    gradient = fit_reverse(padded, 2 * padded, weights)[0]
    assert np.isfinite(gradient).all()
    assert (np.asarray(gradient[:, -1]) == 0).all()


@pytest.mark.slow
def test_reference_cases(x64, shared):
    cases = json.loads((shared / "vectors/umeyama.json").read_text())["cases"]
    assert len(cases) == 19
    for case in cases:
        source, target = np.array(case["src"], float), np.array(case["dst"], float)
        for kind, fixed_scale in (("sim", False), ("rigid", True)):
            if not case["expected_unique"]:
                with pytest.raises(DegenerateGeometryError, match="undetermined"):
                    geometry.fit_similarity(source, target, fixed_scale=fixed_scale)
                continue
            found = geometry.fit_similarity(source, target, fixed_scale=fixed_scale)
            expected = case["expected"][kind]
            # Offsets of 5e6 leave 1e-9 of float64 in the translation.
            size = 1e-9 * (1 + 1e-3 * np.abs(target).max())
            np.testing.assert_allclose(found.scale, expected["scale"], atol=1e-9)
            np.testing.assert_allclose(found.rotation, expected["rotation"], atol=1e-9)
            np.testing.assert_allclose(found.translation, expected["translation"], atol=size)
            error = np.asarray(found(source)) - target
            rmse = np.sqrt(np.mean(np.sum(error**2, axis=1)))
            np.testing.assert_allclose(
                rmse, expected["rmse"], atol=1e-9 * (1 + np.abs(target).max())
            )


@given(st.integers(0, 9), st.floats(1e5, 1e7))
def test_points_far_from_the_origin_turn_and_scale_as_near_ones_in_single_precision(seed, far):
    rng = np.random.default_rng(seed)
    cloud, turn = rng.normal(0, 5, (9, 3)), Rotation.random(random_state=seed).as_matrix()
    absent = np.append(np.ones(8), 0)
    cloud[8] = np.nan
    found = geometry.fit_similarity(cloud + far, 2 * cloud @ turn.T - far, absent)
    assert found.rotation.dtype == jnp.float32
    np.testing.assert_allclose(found.rotation, turn, atol=2e-6)
    np.testing.assert_allclose(found.scale, 2, rtol=2e-6)
    center = np.asarray(found(cloud[:8].mean(0) + far)) - (2 * turn @ cloud[:8].mean(0) - far)
    assert np.abs(center).max() < 1e-5 * far  # what float32 can hold


DEGENERATE = {
    "collinear": np.outer(np.arange(4.0), [1, 2, 3]),
    "coincident": np.full((4, 3), 1e4),
    "two points": np.array([[0.0, 0, 0], [1, 2, 3]]),
    "one point": np.array([[1.0, 2, 3]]),
}


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_points_raise_when_concrete_and_are_finite_when_traced(x64, name, dtype):
    cloud = DEGENERATE[name].astype(dtype)
    with pytest.raises(DegenerateGeometryError, match=f"{len(cloud)} point pairs"):
        geometry.fit_similarity(cloud, cloud)
    # Absent pairs fill up to one shape that is compiled once.
    ones = (np.arange(6) < len(cloud)).astype(dtype)
    cloud = np.pad(cloud, ((0, 6 - len(cloud)), (0, 0)))
    assert np.isfinite(fit_value(cloud, cloud, ones)).all()
    assert np.isfinite(fit_value(cloud, cloud, 0 * ones)).all()
    for jacobian in fit_reverse(cloud, cloud, ones):
        assert np.isfinite(jacobian).all()


def test_the_nearest_rotation_takes_numpy_without_a_warning():
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    with warnings.catch_warnings(action="error"):
        np.testing.assert_allclose(geometry.nearest_rotation(3 * turn), turn, atol=1e-6)


@pytest.mark.slow
def test_equal_singular_values_differentiate(x64):
    cube = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    gradient = fit_reverse(cube, cube, np.ones(6))
    assert all(np.isfinite(g).all() for g in gradient)
    # Turning the targets about z turns the rotation by the same angle.
    velocity = np.cross([0.0, 0, 1], cube)
    change = np.einsum("onk,nk->o", gradient[1], velocity)[1:10].reshape(3, 3)
    np.testing.assert_allclose(change, [[0, -1, 0], [1, 0, 0], [0, 0, 0]], atol=1e-12)


def ring_scene(dtype=np.float64):
    angles = np.linspace(0, 2 * np.pi, 4, endpoint=False)
    centers = np.column_stack([8 * np.cos(angles), 8 * np.sin(angles), np.full(4, 3.0)])
    rotations = []
    for center in centers:
        forward = -center / np.linalg.norm(center)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        rotations.append([right, np.cross(forward, right), forward])
    R = np.array(rotations, dtype)
    K = np.tile(np.array([[1000, 0, 960], [0, 1000, 540], [0, 0, 1]], dtype), (4, 1, 1))
    t = -np.einsum("cij,cj->ci", R, centers).astype(dtype)
    rig = Rig(K, R, t, (1920, 1080))
    return Scene.from_rig(rig, Plane(np.array([0, 0, 1], dtype), dtype(0)), metric=True)


@pytest.mark.slow
@given(similarities(), hnp.arrays(np.float64, 3, elements=st.floats(-3, 3)))
def test_moved_points_keep_pixels_and_relative_distances_in_the_moved_scene(x64, move, point):
    move = Similarity(*move)
    scene = ring_scene()
    moved = geometry.transform_scene(move, scene)
    assert moved.metric
    assert Scene(moved.rig, moved.ground, moved.extent, moved.metric).metric  # at any scale
    assert geometry.transform_scene(move, scene, metric=False).metric is False
    assert isinstance(moved.rig.R, np.ndarray)
    scale = float(move.scale)
    np.testing.assert_allclose(moved.extent, scale * scene.extent)
    np.testing.assert_allclose(moved.rig.centers, move(scene.rig.centers), atol=1e-9 * (1 + scale))
    there = np.asarray(move(point))
    for camera in range(4):
        before, depth = project(
            scene.rig.K[camera], scene.rig.R[camera], scene.rig.t[camera], point
        )
        after, moved_depth = project(
            moved.rig.K[camera], moved.rig.R[camera], moved.rig.t[camera], there
        )
        np.testing.assert_allclose(after, before, atol=1e-6)
        np.testing.assert_allclose(moved_depth, scale * depth, rtol=1e-9)
    np.testing.assert_allclose(
        moved.ground.signed_distance(there), scale * point[2], atol=1e-9 * (1 + scale)
    )


def test_a_scene_moves_under_tracing():
    scene = ring_scene(np.float32)

    @jax.jit
    def extent(scale):
        move = Similarity(scale, jnp.eye(3), jnp.zeros(3))
        moved = geometry.transform_scene(move, scene)
        return moved.extent + jnp.sum(moved.rig.centers)

    assert np.isfinite(jax.grad(extent)(2.0))


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_traced_scenes_move_as_others(dtype):
    scene = ring_scene(dtype)
    turn = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    moves = [Similarity(scale, turn, np.arange(3.0)) for scale in (0.5, 2)]
    several = jax.tree.map(lambda *parts: jnp.stack(parts), *moves)
    for transform, moved in (
        (geometry.transform_rig, scene.rig),
        (geometry.transform_scene, scene),
    ):
        batched = jax.vmap(transform, (0, None))(several, moved)
        for at, move in enumerate(moves):
            expected = transform(move, moved)
            for found in (
                jax.jit(transform)(move, moved),
                jax.jit(lambda s, f=transform, m=moved: f(s, m))(move),
                jax.tree.map(lambda leaf, at=at: leaf[at], batched),
            ):
                jax.tree.map(
                    lambda a, b: np.testing.assert_allclose(a, b, atol=1e-4), found, expected
                )


@pytest.mark.parametrize(
    ("source", "target"), [((0, 3), (0, 3)), ((4, 3), (5, 3)), ((4, 3), (4, 2))]
)
def test_the_fit_names_arrays_that_are_no_pairs(source, target):
    fit = jax.jit(inspect.unwrap(geometry.fit_similarity))  # bypass the tests' shape checks
    with pytest.raises(InvalidInputError, match="pairs"):
        fit(np.zeros(source), np.zeros(target))


def test_the_fit_names_weights_of_another_length():
    points = np.eye(3)
    with pytest.raises(InvalidInputError, match="weights has shape"):
        inspect.unwrap(geometry.fit_similarity)(points, points, np.ones(2))


@pytest.mark.slow
def test_the_fit_says_that_points_are_not_finite():
    points = np.random.default_rng(0).standard_normal((5, 3))
    points[2, 1] = np.nan
    with pytest.raises(DegenerateGeometryError, match="not finite"):
        geometry.fit_similarity(points, points)


@pytest.mark.parametrize("scale", [-1.0, 0.0, np.nan, np.inf])
def test_a_scale_is_positive(scale):
    with pytest.raises(InvalidInputError, match=f"scale of a similarity is {scale}"):
        Similarity(scale, np.eye(3), np.zeros(3))


@pytest.mark.parametrize(
    "matrix",
    [3 * np.eye(3), np.eye(3) + np.eye(3, k=1), np.diag([1.0, 1, -1]), np.full((3, 3), np.nan)],
    ids=["scaled", "sheared", "mirrored", "NaN"],
)
def test_a_rotation_is_proper_unless_traced(matrix):
    with pytest.raises(InvalidInputError, match="rotation is not a rotation"):
        Similarity(1.0, matrix, np.zeros(3))
    moved = jax.jit(lambda m: Similarity(1.0, m, jnp.zeros(3))(jnp.ones(3)))(matrix)
    np.testing.assert_allclose(moved, matrix.sum(1))


def test_a_translation_is_finite_and_a_dimension_positive():
    with pytest.raises(InvalidInputError, match=r"translation\[1\] is not finite"):
        Similarity(1.0, np.eye(2), np.array([0, np.nan]))
    with pytest.raises(InvalidInputError, match="dimension is -1; it must be 1 or more"):
        Similarity.identity(-1)


@pytest.mark.parametrize(
    ("part", "values"),
    [("scale", np.ones(1)), ("rotation", np.eye(2)), ("translation", np.zeros((1, 3)))],
)
def test_parts_of_different_dimensions_are_refused(part, values):
    parts = {"scale": 1.0, "rotation": np.eye(3), "translation": np.zeros(3)} | {part: values}
    for wrong in (parts, {"scale": 1.0, "rotation": 1.0, "translation": 0.0}):
        with pytest.raises(InvalidInputError, match=r"needs .* a rotation \(D, D\)"):
            Similarity(**wrong)


def test_a_similarity_and_a_scene_are_needed():
    with pytest.raises(InvalidInputError, match="first must be a Similarity, got NoneType"):
        inspect.unwrap(Similarity.compose)(Similarity.identity(3), None)
    with pytest.raises(InvalidInputError, match="scene must be a Scene, got NoneType"):
        inspect.unwrap(geometry.CanonicalFrame.of.__func__)(geometry.CanonicalFrame, None)


@pytest.mark.parametrize("fixed", [None, "no", 2])
def test_the_scale_is_fixed_or_not(fixed):
    with pytest.raises(InvalidInputError, match="fixed_scale"):
        inspect.unwrap(geometry.fit_similarity)(np.eye(3), np.eye(3), fixed_scale=fixed)


def test_points_of_other_dimensions_are_refused():
    plan, space = Similarity.identity(2), Similarity.identity(3)
    for use in (lambda: space(np.zeros((5, 2))), lambda: plan @ space):
        with pytest.raises(InvalidInputError, match=r"this similarity moves points \(\.\.\., \d\)"):
            use()


def test_what_cannot_be_moved_is_told_so():
    rig = Rig(np.eye(3)[None], np.eye(3)[None], np.zeros((1, 3)), (9, 9))
    ground = Plane([0.0, 0.0, 1.0], 1.0)
    move_rig, move_plane, move_scene = (
        inspect.unwrap(f)
        for f in (geometry.transform_rig, geometry.transform_plane, geometry.transform_scene)
    )
    nearest, moves = inspect.unwrap(geometry.nearest_rotation), Similarity.identity()
    for use, message in (
        (lambda: move_rig(moves, Scene(rig, ground, 1.0)), "rig must be a Rig, got Scene. Pass"),
        (lambda: move_plane(moves, rig), "plane must be a Plane, got Rig"),
        (lambda: move_scene(moves, rig), "scene must be a Scene, got Rig"),
        (lambda: move_plane(Similarity.identity(2), ground), "of the similarity must have shape"),
        (lambda: nearest(5.0), r"matrix must have shape \(n\), got \(\)"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            use()
