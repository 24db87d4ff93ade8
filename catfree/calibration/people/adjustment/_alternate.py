"""Alternation of grouping and bundle adjustment as the cameras' maps become more accurate."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.adjustment._people_bundle import (
    BoxMeasurements,
    BundleResult,
    adjust_people_bundle,
    weak_prior,
)
from catfree.calibration.people.cameras._camera_model import usual_focal
from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS
from catfree.calibration.people.matching._group_people import People, RigState, group_people
from catfree.settings import CalibrationSettings
from catfree.types._sampling import evenly_spread

MOST_PEOPLE = 2500  # per adjustment, evenly spread over the frames
MOST_STEPS = 10  # per adjustment


def measure_people(
    grid: BoxGrid, people: People
) -> tuple[BoxMeasurements, Float[np.ndarray, "person 3"]]:
    """Select the boxes of people with several views, and their initial positions.

    Args:
        grid: all boxes.
        people: the grouping of the boxes.

    Returns:
        The boxes, and ground positions and heights (P, 3) in meters.
    """
    shared = np.argwhere((people.members >= 0).sum(-1) >= 2)
    time, slot = evenly_spread(shared, MOST_PEOPLE).T
    members = people.members[time, slot]
    person, camera = np.nonzero(members >= 0)
    at = (camera, time[person], members[person, camera])
    sd = np.repeat(grid.sd[at][:, None], 3, axis=1)
    data = BoxMeasurements(person, camera, grid.box[at], sd)
    ground = people.ground
    return data, np.column_stack([ground.xy[time, slot], ground.height[time, slot]])


def alternate(
    grid: BoxGrid, state: RigState, settings: CalibrationSettings
) -> tuple[RigState, BundleResult] | None:
    """Group people and adjust the rig, once per range error, the largest first.

    Args:
        grid: all boxes.
        state: the initial rig.
        settings: constants.

    Returns:
        The rig and its last adjustment; None if no person is seen by two cameras.
    """
    middle = np.log(usual_focal(grid.size, settings))
    bundle = None
    for tolerance in RANGE_ERRORS:
        limited = replace(state, range_tolerance=tolerance)
        data, ground = measure_people(grid, group_people(grid, limited, settings))
        if not len(ground):
            break
        bundle = adjust_people_bundle(
            data,
            state.parameters,
            ground,
            weak_prior(data.camera, state.parameters, middle, settings),
            settings,
            focal_spread=settings.focal_spread,
            iterations=MOST_STEPS,
        )
        placed = np.isfinite(bundle.parameters)
        state = replace(limited, parameters=np.where(placed, bundle.parameters, state.parameters))
    return None if bundle is None else (state, bundle)
