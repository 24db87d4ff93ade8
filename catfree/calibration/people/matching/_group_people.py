"""Grouping of several cameras' boxes into one map of people on the ground."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL
from catfree.calibration.people.cameras._ground_map import GroundMap, map_camera
from catfree.calibration.people.matching._mutual_nearest import mutual_nearest
from catfree.settings import CalibrationSettings


@dataclass(frozen=True)
class RigState:
    """A rig under construction.

    Attributes:
        parameters: (C, 7) cameras; NaN where not placed.
        range_tolerance: fraction of the range by which the map of a camera may be wrong.
    """

    parameters: Float[np.ndarray, "cam 7"]
    range_tolerance: float

    @property
    def placed(self) -> Bool[np.ndarray, " cam"]:
        """(C,) whether each camera is placed."""
        return np.isfinite(self.parameters[:, LOG_FOCAL])

    def with_camera(self, camera: int, parameters: Float[np.ndarray, "7"]) -> "RigState":
        """Add a camera to the rig, or move it."""
        every = self.parameters.copy()
        every[camera] = parameters
        return replace(self, parameters=every)

    def without_camera(self, camera: int) -> "RigState":
        """Remove a camera from the rig."""
        return self.with_camera(camera, np.full(7, np.nan))


@dataclass(frozen=True)
class People:
    """People in all frames seen by the placed cameras.

    Attributes:
        ground: positions of the people.
        members: (T, M, C) slot of each camera's box, or -1.
    """

    ground: GroundMap
    members: Int[np.ndarray, "frame person cam"]


def group_people(
    grid: BoxGrid,
    state: RigState,
    settings: CalibrationSettings,
) -> People:
    """Group the boxes of all placed cameras into people, frame by frame.

    Cameras are added one by one, the one with most boxes first. Mutually nearest people within the
    gate are merged; the others stay separate.

    Args:
        grid: all boxes.
        state: the rig.
        settings: constants.
    """
    cameras = sorted(np.flatnonzero(state.placed).tolist(), key=lambda c: -int(grid.valid[c].sum()))
    first, *others = (
        map_camera(grid, c, state.parameters[c], settings, state.range_tolerance) for c in cameras
    )
    members = np.full((*first.valid.shape, grid.camera_count), -1)
    members[:, :, cameras[0]] = np.where(first.valid, np.arange(first.valid.shape[1]), -1)
    people = first
    for camera, camera_people in zip(cameras[1:], others, strict=True):
        people, members = _merge(people, members, camera_people, camera, settings.match_gate)
    return People(people, members)


def _merge(
    people: GroundMap,
    members: Int[np.ndarray, "frame person cam"],
    added: GroundMap,
    camera: int,
    gate: float,
) -> tuple[GroundMap, Int[np.ndarray, "frame merged cam"]]:
    """Merge one camera's people into a map."""
    time, slot, partner, *_ = mutual_nearest(people, added, gate)
    members = members.copy()
    members[time, slot, camera] = partner
    merged = GroundMap(*(part.copy() for part in vars(people).values()))
    a, b = people.covariance[time, slot], added.covariance[time, partner]
    gain = a @ np.linalg.inv(a + b)
    step = added.xy[time, partner] - people.xy[time, slot]
    merged.xy[time, slot] += np.einsum("nij,nj->ni", gain, step)
    merged.covariance[time, slot] = a - gain @ a
    tall, other = people.height[time, slot], added.height[time, partner]
    wa, wb = people.height_sd[time, slot] ** -2, added.height_sd[time, partner] ** -2
    merged.height[time, slot] = (wa * tall + wb * other) / (wa + wb)
    merged.height_sd[time, slot] = (wa + wb) ** -0.5
    unmatched = added.valid.copy()
    unmatched[time, partner] = False
    added = replace(added, valid=unmatched)
    added_members = np.full((*unmatched.shape, members.shape[2]), -1)
    added_members[:, :, camera] = np.where(unmatched, np.arange(unmatched.shape[1]), -1)
    valid = np.concatenate([people.valid, unmatched], 1)
    # Move the people of each frame to the front and remove the empty columns.
    order = np.argsort(~valid, axis=1, kind="stable")[:, : max(1, int(valid.sum(1).max()))]

    def packed(
        one: Shaped[np.ndarray, "frame person *of"], two: Shaped[np.ndarray, "frame added *of"]
    ) -> Shaped[np.ndarray, "frame merged *of"]:
        joined = np.concatenate([one, two], 1)
        return joined[np.arange(len(joined))[:, None], order]

    both = zip(vars(merged).values(), vars(added).values(), strict=True)
    return GroundMap(*(packed(*parts) for parts in both)), packed(members, added_members)
