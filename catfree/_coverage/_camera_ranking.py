"""The value of single cameras: coverage with one more or one fewer, and a ranking."""

from typing import Any, Unpack

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from catfree._coverage._expected_sigma import (
    Area,
    Coverage,
    CoverageOptions,
    coverage,
    coverage_of,
    visible_area,
)
from catfree.errors import DegenerateGeometryError, InvalidInputError
from catfree.types import Lens, Plane, Rig, Scene
from catfree.types._annotations import HostOrDevice
from catfree.types._scene import require_scene
from catfree.types._validation import as_count, as_finite

PARALLEL = 1e-6  # sine of the angle to the ground's normal below which upright is undefined


class CameraRanking(eqx.Module):
    """Coverage lost without each camera of the rig.

    Attributes:
        order: (K,) the registered cameras, the least important first.
        accuracy: `Coverage.accuracy` of the whole rig.
        accuracy_without: (K,) accuracy without each camera of `order`.
        covered_without: (K,) share of the area seen by two cameras without it.
        median_sigma_without: (K,) median sigma without it, scene units.
    """

    order: Int[np.ndarray, " k"]
    accuracy: float
    accuracy_without: Float[np.ndarray, " k"]
    covered_without: Float[np.ndarray, " k"]
    median_sigma_without: Float[np.ndarray, " k"]


class CameraGain(eqx.Module):
    """Gain from one more camera.

    Attributes:
        before: coverage of the present rig.
        after: coverage with the new camera, appended as the last one, over the same cells.
    """

    before: Coverage
    after: Coverage

    @property
    def accuracy(self) -> float:
        """Gain in `Coverage.accuracy`, never below 0 except for rounding."""
        return self.after.accuracy - self.before.accuracy

    @property
    def covered(self) -> float:
        """Gain in the share of the area that at least two cameras see."""
        return self.after.covered - self.before.covered

    @property
    def sigma_ratio(self) -> Float[np.ndarray, "height width"]:
        """(H, W) sigma after over sigma before: at most 1, 0 where the new camera is the second."""
        finite = np.isfinite(self.before.sigma)
        ratio = self.after.sigma / np.where(finite, self.before.sigma, 1)
        return np.where(finite, ratio, np.where(np.isfinite(self.after.sigma), 0.0, 1.0))

    def __str__(self) -> str:
        return (
            f"{100 * self.accuracy:+.1f} % of positions within {self.before.radius:.3g}, "
            f"{100 * self.covered:+.1f} % of the area seen by two cameras"
        )


def camera_gain(
    scene: Scene,
    center: Float[HostOrDevice, "3"],
    target: Float[HostOrDevice, "3"],
    area: Area | None = None,
    *,
    like: int | None = None,
    **options: Unpack[CoverageOptions],
) -> CameraGain:
    """Compute the gain from one more camera at a given place.

    Args:
        scene: cameras, ground and extent.
        center: (3,) center of the new camera, scene units.
        target: (3,) the point that it looks at, scene units; the camera is upright.
        area: as in `coverage`; None for the area of the present rig.
        like: index of the camera to copy (focal length and image size, without lens distortion);
            None for the first registered camera.
        **options: the other options of `coverage`.

    Returns:
        Coverage before and after. It moves with the scene under similarity transforms, and another
        camera never makes any place worse.

    Raises:
        InsufficientDataError: if fewer than two cameras are registered.
        InvalidInputError: if the camera to copy is not registered, or a point is not (3,).
        DegenerateGeometryError: if the camera would look along the ground's normal.
    """
    require_scene(scene)
    registered = np.asarray(scene.rig.registered)
    area = visible_area(scene) if area is None else area
    like = int(np.argmax(registered)) if like is None else as_count(like, "like")
    if not (0 <= like < len(registered) and registered[like]):
        raise InvalidInputError(
            f"like is {like}, which is not a registered camera; choose one of "
            f"{np.flatnonzero(registered).tolist()}."
        )
    center, target = as_finite(center, (3,), "center"), as_finite(target, (3,), "target")
    rotation = _upright(center, target, np.asarray(scene.ground.normal, np.float64))
    larger = _with_camera(scene, like, rotation, -rotation @ center)
    after = coverage(larger, area, **options)
    return CameraGain(before=coverage(scene, area, **options), after=after)


def rank_cameras(
    scene: Scene, area: Area | None = None, **options: Unpack[CoverageOptions]
) -> CameraRanking:
    """Rank the cameras by the accuracy of the rig without them.

    Args:
        scene: cameras, ground and extent.
        area: as in `coverage`.
        **options: the other options of `coverage`.

    Returns:
        Cameras sorted by the accuracy without them, the least important first.

    Raises:
        InvalidInputError: if the scene or the area has another type.
    """
    require_scene(scene)
    area = visible_area(scene) if area is None else area
    registered = np.asarray(scene.rig.registered)
    cameras = np.flatnonzero(registered)
    others = [registered & (np.arange(len(registered)) != camera) for camera in cameras]
    without = [coverage_of(scene, active, area, **options) for active in others]
    accuracy_without = np.array([reduced.accuracy for reduced in without])
    order = np.argsort(-accuracy_without, kind="stable")
    return CameraRanking(
        order=cameras[order],
        accuracy=coverage(scene, area, **options).accuracy,
        accuracy_without=accuracy_without[order],
        covered_without=np.array([reduced.covered for reduced in without])[order],
        median_sigma_without=np.array([reduced.median_sigma for reduced in without])[order],
    )


def _with_camera(
    scene: Scene, like: int, R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, "3"]
) -> Scene:
    """Add a camera without lens distortion that is otherwise like another one."""

    def append(values: Any, more: Any) -> np.ndarray:
        return np.concatenate([np.asarray(values, np.float64), np.asarray(more, np.float64)[None]])

    rig, lens = scene.rig, scene.rig.distortion
    larger = Rig(
        append(rig.K, rig.K[like]),
        append(rig.R, R),
        append(rig.t, t),
        append(rig.image_size, rig.image_size[like]),
        None if lens is None else append(lens, np.zeros(lens.shape[1])),
        np.append(rig.registered, True),
        np.append(rig.lenses, Lens.PINHOLE),
        None if rig.rays is None else append(rig.rays, rig.rays[0]),
    )
    ground = Plane(np.asarray(scene.ground.normal, np.float64), np.float64(scene.ground.offset))
    return Scene(larger, ground, np.float64(scene.extent), scene.metric)


def _upright(center: Any, target: Any, up: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """World-to-camera rotation of a camera that looks at the target with level image rows."""
    sight = np.asarray(target, np.float64) - np.asarray(center, np.float64)
    right = np.cross(sight, up)
    if not np.linalg.norm(right) > PARALLEL * np.linalg.norm(sight):
        raise DegenerateGeometryError(
            f"A camera at {np.asarray(center)} that looks at {np.asarray(target)} looks straight "
            "up or down, so its roll is undefined: move one of the two points aside."
        )
    forward, right = sight / np.linalg.norm(sight), right / np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])
