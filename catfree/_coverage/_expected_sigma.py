"""Coverage: expected uncertainty and number of cameras over a rectangle of the ground."""

from collections.abc import Sequence
from typing import TypedDict

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree._coverage._sight import look
from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.geometry._plane import to_plan
from catfree.settings import RaySettings, SelectionSettings
from catfree.types import Scene
from catfree.types._scene import require_scene
from catfree.types._validation import as_area, as_positive

Area = Sequence[float | int] | Float[np.ndarray, "4"]

SIGMA_THETA = RaySettings().sigma_theta
SUPPRESSION_RADIUS = SelectionSettings().suppression_radius
MOST_CELLS = 4_000_000  # a hundred times as many as at the default resolution
CELLS_PER_EXTENT = 100  # default resolution: a cell of E / 100 is half the suppression radius


class CoverageOptions(TypedDict, total=False):
    """The options of `coverage`, which other functions pass on to it.

    Attributes:
        resolution: side of a cell in scene units; None for E / 100.
        sigma_theta: angular noise of a foot ray in radians.
        person_height: height in scene units up to which a person must be in the picture; None
            requires only the feet.
    """

    resolution: float | int | None
    sigma_theta: float | int
    person_height: float | int | None


class Coverage(eqx.Module):
    """Expected uncertainty and number of cameras over a rectangle of the ground.

    Attributes:
        x: (W,) first ground coordinate of the cell centers (along `Plane.basis`), scene units.
        y: (H,) second ground coordinate.
        visible: (C, H, W) whether each camera sees a person standing in the cell.
        sigma: (H, W) expected ground uncertainty (Eq. sigma with w = 1) in scene units; inf where
            fewer than two cameras see the cell.
        radius: length in scene units within which `accuracy` counts a position as right.
        area: x_min, x_max, y_min, y_max of the outer edges of the cells.
    """

    x: Float[np.ndarray, " width"]
    y: Float[np.ndarray, " height"]
    visible: Bool[np.ndarray, "cam height width"]
    sigma: Float[np.ndarray, "height width"]
    radius: float
    area: tuple[float, float, float, float]

    @property
    def cameras(self) -> Int[np.ndarray, "height width"]:
        """(H, W) number of cameras that see each cell."""
        return self.visible.sum(axis=0)

    @property
    def xy(self) -> Float[np.ndarray, "height width 2"]:
        """(H, W, 2) ground coordinates of the cell centers."""
        return np.stack(np.meshgrid(self.x, self.y), axis=-1)

    @property
    def covered(self) -> float:
        """Share of the area that at least two cameras see, where people can be localized."""
        return float((self.cameras >= 2).mean())

    @property
    def median_sigma(self) -> float:
        """Median uncertainty over the area; inf if less than half of it is covered."""
        return float(np.sort(self.sigma, axis=None)[self.sigma.size // 2])

    @property
    def accuracy(self) -> float:
        """Probability that a person anywhere in the area is localized within `radius`.

        The mean of `1 - exp(-radius² / (2 sigma²))`, the mass of an isotropic Gaussian in a disc;
        0 where sigma is infinite. It is finite and never falls when a camera is added.
        """
        with np.errstate(over="ignore"):
            return float(np.mean(-np.expm1(-((self.radius / self.sigma) ** 2) / 2)))

    def __str__(self) -> str:
        return (
            f"{100 * self.covered:.0f} % of the area seen by two cameras, median sigma "
            f"{self.median_sigma:.3g}, {100 * self.accuracy:.0f} % of positions expected within "
            f"{self.radius:.3g}"
        )


def coverage(
    scene: Scene,
    area: Area | None = None,
    *,
    resolution: float | int | None = None,
    sigma_theta: float | int = SIGMA_THETA,
    person_height: float | int | None = None,
) -> Coverage:
    """Predict where on the ground the rig can localize people, and how precisely.

    Args:
        scene: cameras, ground and extent.
        area: x_min, x_max, y_min, y_max in ground coordinates (`Plane.basis`), scene units; None
            for the ground that two cameras see within E of the mean camera.
        resolution: side of a cell in scene units; None for E / 100.
        sigma_theta: angular noise of a foot ray in radians.
        person_height: height of the head above the feet in scene units; a person counts as seen
            only if both are inside the picture. None requires only the feet.

    Returns:
        The map. It moves with the scene under similarity transforms.

    Raises:
        InsufficientDataError: if fewer than two cameras are registered.
        InvalidInputError: if the area is empty, a length or sigma_theta is not positive, or the
            area has too many cells.

    Source:
        paper, Eq. sigma, with the true directions and weight 1.
    """
    require_scene(scene)
    registered = np.asarray(scene.rig.registered)
    return coverage_of(scene, registered, area, resolution, sigma_theta, person_height)


def visible_area(scene: Scene) -> tuple[float, float, float, float]:
    """Find the rectangle around the ground seen by two cameras, within E of the mean camera.

    Args:
        scene: cameras, ground and extent.

    Returns:
        x_min, x_max, y_min, y_max in ground coordinates, scene units; the square of side 2 E
        around the mean camera center if no two cameras see common ground.
    """
    registered = np.asarray(scene.rig.registered)
    require_two(registered)
    middle = to_plan(scene, np.asarray(scene.rig.centers, np.float64)[registered].mean(0))
    reach, extent = np.linspace(-1, 1, CELLS_PER_EXTENT + 1), float(scene.extent)
    offset = np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2)
    offset = offset[np.linalg.norm(offset, axis=-1) <= 1]
    visible, _ = look(scene, registered, middle + extent * offset, SIGMA_THETA, None)
    shared = offset[visible.sum(0) >= 2]
    shared = offset if len(shared) == 0 else shared
    margin = 1 / CELLS_PER_EXTENT
    low = middle + extent * (shared.min(0) - margin)
    high = middle + extent * (shared.max(0) + margin)
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def coverage_of(
    scene: Scene,
    active: Bool[np.ndarray, " cam"],
    area: Area | None,
    resolution: float | int | None = None,
    sigma_theta: float | int = SIGMA_THETA,
    person_height: float | int | None = None,
) -> Coverage:
    """Compute `coverage` by the cameras for which `active` (C,) is true."""
    require_two(np.asarray(scene.rig.registered))
    extent = float(scene.extent)
    cell = extent / CELLS_PER_EXTENT
    if resolution is not None:
        cell = as_positive(resolution, "resolution")
    sigma_theta = as_positive(sigma_theta, "sigma_theta")
    if person_height is not None:
        person_height = as_positive(person_height, "person_height")
    bounds = visible_area(scene) if area is None else as_area(area)
    sides = (bounds[1] - bounds[0], bounds[3] - bounds[2])
    if (sides[0] / cell + 1) * (sides[1] / cell + 1) > MOST_CELLS:
        raise InvalidInputError(
            f"A resolution of {cell:.3g} over an area of {sides[0]:.3g} x {sides[1]:.3g} gives "
            f"more than {MOST_CELLS} cells: choose larger cells or a smaller area."
        )
    x, y = _cell_centers(bounds[0], bounds[1], cell), _cell_centers(bounds[2], bounds[3], cell)
    places = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    visible, sigma = look(scene, active, places, sigma_theta, person_height)
    shape, radius = (len(y), len(x)), SUPPRESSION_RADIUS * extent
    return Coverage(x, y, visible.reshape(-1, *shape), sigma.reshape(shape), radius, bounds)


def _cell_centers(low: float, high: float, cell: float) -> np.ndarray:
    count = max(int(np.ceil((high - low) / cell - 1e-6)), 1)
    return low + (high - low) * (np.arange(count) + 0.5) / count


def require_two(registered: Bool[np.ndarray, " cam"]) -> None:
    """Raise if fewer than two cameras are registered."""
    if registered.sum() < 2:
        raise InsufficientDataError(
            f"Coverage needs at least 2 registered cameras, got {int(registered.sum())}: one ray "
            "alone cannot be triangulated."
        )
