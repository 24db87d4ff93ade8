"""Alternate grouping and bundle adjustment as the maps of the cameras become more accurate."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.adjustment._people_bundle import (
    BoxMeasurements,
    BundleResult,
    adjust_people_bundle,
    weak_prior,
)
from catfree.calibration.people.matching._group_people import People, RigState, group_people
from catfree.calibration.people.matching._verdict import PlacementVerdict
from catfree.errors import CalibrationError
from catfree.settings import CalibrationSettings
from catfree.types._sampling import evenly_spread


@dataclass(frozen=True)
class AdjustedRig:
    """A rig after bundle adjustment, and how well its cameras agree.

    Attributes:
        state: the rig.
        bundle: the last adjustment.
        verdicts: of the cameras that were judged since.
    """

    state: RigState
    bundle: BundleResult
    verdicts: dict[int, PlacementVerdict] = field(default_factory=dict)

    @property
    def quality(self) -> tuple[int, float]:
        """Number of placed cameras, and the sum of their evidence above chance."""
        margins = sum((verdict.margin for verdict in self.verdicts.values()), 0.0)
        return int(self.state.placed.sum()), margins

    @property
    def accepted(self) -> int:
        """Number of cameras that can be trusted."""
        return sum(verdict.accepted for verdict in self.verdicts.values())

    @property
    def evidence(self) -> float:
        """Sum of the evidence above chance of all cameras that can be trusted."""
        return sum(v.margin for v in self.verdicts.values() if v.accepted)


def measure_people(
    grid: BoxGrid, people: People, most: int
) -> tuple[BoxMeasurements, Float[np.ndarray, "person 3"]] | None:
    """Select the boxes of people with several views, and their initial positions.

    Args:
        grid: all boxes.
        people: the grouping of the boxes.
        most: maximum number of people, spread evenly over the frames.

    Returns:
        The boxes, and ground positions and heights (P, 3) in meters; None if there are no people.
    """
    time, slot = np.nonzero((people.members >= 0).sum(-1) >= 2)
    if not len(time):
        return None
    time, slot = evenly_spread(time, most), evenly_spread(slot, most)
    members = people.members[time, slot]
    person, camera = np.nonzero(members >= 0)
    at = (camera, time[person], members[person, camera])
    sd = np.repeat(grid.sd[at][:, None], 3, axis=1)
    data = BoxMeasurements(person, camera, grid.box[at], sd)
    ground = people.ground
    return data, np.column_stack([ground.xy[time, slot], ground.height[time, slot]])


def alternate(
    grid: BoxGrid,
    state: RigState,
    settings: CalibrationSettings,
    *,
    tolerances: tuple[float, ...],
    most_people: int = 2500,
    iterations: int = 10,
) -> AdjustedRig:
    """Group people and adjust the rig, once per range tolerance.

    Args:
        grid: all boxes.
        state: the initial rig.
        settings: constants.
        tolerances: range tolerances of the rounds, for all cameras.
        most_people: maximum number of people used.
        iterations: maximum number of steps per adjustment.

    Returns:
        The adjusted rig.

    Raises:
        CalibrationError: if no person is seen by two cameras.
    """
    middle = np.log(np.median(settings.focal_shares) * grid.size.max(1))
    bundle = None
    for tolerance in tolerances:
        limited = replace(state, range_tolerance=np.full(grid.camera_count, tolerance))
        people = group_people(grid, limited, settings)
        measured = measure_people(grid, people, most_people)
        if measured is None:
            break
        data, start = measured
        bundle = adjust_people_bundle(
            data,
            state.parameters,
            start,
            weak_prior(data.camera, state.parameters, middle, settings),
            settings,
            focal_spread=settings.shared_focal_sd if state.shared_focal else np.inf,
            iterations=iterations,
        )
        parameters = np.where(np.isfinite(bundle.parameters), bundle.parameters, state.parameters)
        state = replace(limited, parameters=parameters)
    if bundle is None:
        cameras = ", ".join(str(c) for c in np.flatnonzero(state.placed))
        raise CalibrationError(
            f"Cameras {cameras} cannot be adjusted together: no person is seen by two of them."
        )
    return AdjustedRig(state, bundle)
