"""Rays through the feet against direct intersections, and wrong grounds that they reveal."""

import dataclasses

import jax
import numpy as np
import pytest

import catfree as cf
from catfree.geometry import transform_scene
from catfree.geometry._similarity import Similarity
from catfree.methods.evidence import _localize_by_evidence as conversion
from catfree.methods.evidence._solve import solve
from catfree.methods.evidence.report import _ray_diagnostics
from catfree.synthetic import make_world, ring
from catfree.types import Plane, Scene

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def world():
    return make_world("ring4", 1, frames=20, people=6, background=0)


@pytest.fixture(scope="module")
def found(world):
    return cf.localize(world.detections, world.true_scene)


def raised(scene: Scene, by: float) -> Scene:
    """Move the ground plane of the scene up."""
    ground = scene.ground
    return dataclasses.replace(scene, ground=Plane(ground.normal, float(ground.offset) - by))


def test_heights_are_those_of_the_meeting_points(world):
    """Compute least squares over the lines through the foot pixels, in the scene's frame."""
    solution = solve(world.detections, world.true_scene)
    rig, boxes = world.true_scene.rig, solution.boxes
    with jax.enable_x64(True):
        found = _ray_diagnostics.ray_diagnostics(
            boxes, solution.measurements, solution.groups, solution.views
        )
    for group in np.flatnonzero(np.isfinite(found.height))[::7]:
        lines, noise = [], []
        for row in solution.groups.member[group]:
            if row < 0 or not solution.measurements.used[row, 2]:
                continue
            camera = boxes.camera[row]
            pixel = [boxes.box[row, [0, 2]].mean(), boxes.box[row, 3], 1]
            ray = np.asarray(rig.R)[camera].T @ np.linalg.solve(np.asarray(rig.K)[camera], pixel)
            # On the ground, the body stands 0.15 m beyond the visible foot.
            center = np.asarray(rig.centers)[camera]
            shown = (ray * center[2] / -ray[2])[:2]
            beyond = 0.15 / 1.7 * float(solution.views.unit)
            ray = np.append(shown * (1 + beyond / np.linalg.norm(shown)), -center[2])
            ray /= np.linalg.norm(ray)
            lines.append((np.asarray(rig.centers)[camera], np.eye(3) - np.outer(ray, ray)))
            noise.append(solution.measurements.noise[row, 2] / rig.K[camera, 0, 0])
        total = sum(across / angle**2 for (_, across), angle in zip(lines, noise, strict=True))
        right = sum(a @ o / angle**2 for (o, a), angle in zip(lines, noise, strict=True))
        point = np.linalg.solve(total, right)
        unit = float(solution.views.unit)
        assert found.height[group] * unit == pytest.approx(point[2], abs=1e-5)
        spread = sum(
            across / (angle * np.linalg.norm(point - o)) ** 2
            for (o, across), angle in zip(lines, noise, strict=True)
        )
        sigma = np.sqrt(np.trace(np.linalg.inv(spread)[:2, :2]) / 2)
        assert found.sigma[group] * unit == pytest.approx(sigma, rel=1e-4)


def test_one_ray_knows_neither_its_sigma_nor_its_height(found):
    rays = (found.candidates.support >= 0).sum(1)
    known = np.isfinite(found.candidates.sigma)
    assert not known[rays < 2].any()
    assert known[rays == 4].all()
    assert (rays < 2).any()
    for name in ("ground_distance", "rms_angle"):
        np.testing.assert_array_equal(np.isfinite(getattr(found.candidates, name)), known)


def test_a_right_ground_is_not_mentioned(found):
    assert abs(found.reliability.ground_height) < 0.15
    assert found.warnings == ()


@pytest.mark.parametrize(
    ("by", "said"),
    [
        (0.4, "below the ground plane: the plane is too high"),
        (-0.5, "above the ground plane: the plane is too low"),
    ],
)
def test_a_ground_off_by_a_step_is_told(world, found, by, said):
    wrong = cf.localize(world.detections, raised(world.true_scene, by))
    moved = wrong.reliability.ground_height - found.reliability.ground_height
    assert moved == pytest.approx(-by, abs=0.05)
    (warning,) = wrong.warnings
    assert said in warning


def test_the_frame_and_unit_of_the_scene_only_scale_it(world, found):
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    scene = dataclasses.replace(world.true_scene, metric=False)
    moved = cf.localize(
        world.detections, transform_scene(Similarity(3.0, turn, np.array([1.0, 2, 3])), scene)
    )
    height = found.reliability.ground_height
    assert moved.reliability.ground_height == pytest.approx(3 * height, rel=1e-3)
    known = np.isfinite(found.candidates.sigma)
    np.testing.assert_allclose(
        moved.candidates.sigma[known], 3 * found.candidates.sigma[known], rtol=1e-3
    )


def test_a_right_ground_is_right_for_cameras_that_look_down_steeply():
    """Seen from above, a foot a step ahead of the body seems to be far below the ground."""
    steep = make_world(ring(5, height=(18.0, 20.0)), 1, frames=20, people=6, background=0)
    found = cf.localize(steep.detections, steep.true_scene)
    assert abs(found.reliability.ground_height) < 0.15
    assert found.warnings == ()


def test_few_people_do_not_tell_the_ground(world):
    one = world.detections[world.detections.frame < 2]
    result = cf.localize(one, raised(world.true_scene, 0.4))
    assert np.isnan(result.reliability.ground_height)
    assert not any("ground plane" in warning for warning in result.warnings)


def test_the_default_method_runs_the_four_functions_of_rays(world, monkeypatch):
    """Triangulation, Λ, sigma and the plane test: functions called here are traced."""
    called = set()
    for name in ("triangulate_least_squares", "information", "ground_sigma", "plane_distance"):
        original = getattr(_ray_diagnostics, name)
        assert original is getattr(cf.geometry, name)

        def spy(*arguments, name=name, original=original):
            called.add(name)
            return original(*arguments)

        monkeypatch.setattr(_ray_diagnostics, name, spy)
    _ray_diagnostics._diagnose.clear_cache()
    cf.localize(world.detections[world.detections.frame < 2], world.true_scene)
    _ray_diagnostics._diagnose.clear_cache()
    assert called == {
        "triangulate_least_squares", "information", "ground_sigma", "plane_distance",
    }  # fmt: skip


def test_an_unknown_height_is_not_a_warning():
    world = make_world("ring4", 0, frames=1, people=1)
    assert conversion.ground_warnings(float("nan"), 1.7, world.scene) == ()


@pytest.mark.parametrize("scale", [0.01, 0.3048, 1.0, 3.2808])
def test_a_unit_that_is_not_the_meter_is_told(world, scale):
    moved = transform_scene(Similarity(scale, np.eye(3), np.zeros(3)), world.true_scene)
    for metric in (True, False):
        found = cf.localize(world.detections, dataclasses.replace(moved, metric=metric))
        told = [warning for warning in found.warnings if "m tall in this scene" in warning]
        assert len(told) == (metric and scale != 1)
