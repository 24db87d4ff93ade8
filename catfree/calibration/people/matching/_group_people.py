"""The people of a rig: boxes of several cameras grouped into one map of the ground."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from catfree.calibration.people._box_grid import BoxGrid
from catfree.calibration.people.cameras._ground_map import GroundMap, map_ground, visible
from catfree.calibration.people.matching._mutual_nearest import mutual_nearest, squared_distances
from catfree.settings import CalibrationSettings


@dataclass(frozen=True)
class RigState:
    """A rig under construction.

    Attributes:
        parameters: (C, 7) cameras; NaN where not placed.
        placed: (C,) which cameras have a place.
        foot_offset: metres.
        range_tolerance: (C,) share of the range by which each camera's map may still be wrong.
    """

    parameters: Float[np.ndarray, "cam 7"]
    placed: Bool[np.ndarray, " cam"]
    foot_offset: float
    range_tolerance: Float[np.ndarray, " cam"]

    def with_camera(
        self, camera: int, parameters: Float[np.ndarray, "7"], tolerance: float
    ) -> "RigState":
        """The rig with one more camera.

        Args:
            camera: which camera.
            parameters: (7,) where it stands.
            tolerance: share of the range by which its map may be wrong.
        """
        all_parameters, placed = self.parameters.copy(), self.placed.copy()
        tolerances = self.range_tolerance.copy()
        all_parameters[camera], placed[camera], tolerances[camera] = parameters, True, tolerance
        return RigState(all_parameters, placed, self.foot_offset, tolerances)

    def without_camera(self, camera: int) -> "RigState":
        """The rig with one camera taken out."""
        all_parameters, placed = self.parameters.copy(), self.placed.copy()
        all_parameters[camera], placed[camera] = np.nan, False
        return RigState(all_parameters, placed, self.foot_offset, self.range_tolerance)


@dataclass(frozen=True)
class People:
    """People of all frames seen by the placed cameras.

    Attributes:
        ground: their map.
        members: (T, M, C) slot of each camera's box, or -1.
    """

    ground: GroundMap
    members: Int[np.ndarray, "frame person cam"]

    @property
    def views(self) -> Int[np.ndarray, "frame person"]:
        """(T, M) number of cameras that see each person."""
        return (self.members >= 0).sum(-1)


def camera_map(
    grid: BoxGrid, camera: int, state: RigState, settings: CalibrationSettings
) -> GroundMap:
    """One placed camera's map of the ground in world coordinates.

    Args:
        grid: all boxes.
        camera: which camera.
        state: the rig.
        settings: constants.
    """
    return map_ground(
        state.parameters[camera],
        grid.u[camera],
        grid.top[camera],
        grid.bottom[camera],
        grid.sd[camera],
        grid.valid[camera],
        settings,
        foot_offset=state.foot_offset,
        range_tolerance=state.range_tolerance[camera],
    )


def group_people(
    grid: BoxGrid,
    state: RigState,
    settings: CalibrationSettings,
    *,
    without: int | None = None,
    gate: float | None = None,
) -> People:
    """Group the boxes of all placed cameras into people, frame by frame.

    Cameras are added one after the other, most boxes first; mutually nearest people within the gate
    become one, the rest stay apart.

    Args:
        grid: all boxes.
        state: the rig.
        settings: constants.
        without: a camera to leave out.
        gate: largest squared Mahalanobis distance; the settings' by default.
    """
    cameras = [int(c) for c in np.flatnonzero(state.placed) if c != without]
    cameras.sort(key=lambda c: -int(grid.valid[c].sum()))
    gate = settings.match_gate if gate is None else gate
    first, *rest = (camera_map(grid, c, state, settings) for c in cameras)
    members = np.full((*first.valid.shape, grid.camera_count), -1)
    members[:, :, cameras[0]] = np.where(first.valid, np.arange(first.valid.shape[1]), -1)
    people = first
    for camera, own in zip(cameras[1:], rest, strict=True):
        people, members = _merge(people, members, own, camera, gate)
    return People(people, members)


def _merge(
    people: GroundMap,
    members: Int[np.ndarray, "frame person cam"],
    own: GroundMap,
    camera: int,
    gate: float,
) -> tuple[GroundMap, Int[np.ndarray, "frame merged cam"]]:
    """Add one camera's people to a map."""
    time, slot, partner = mutual_nearest(*squared_distances(people, own), gate)
    members = members.copy()
    members[time, slot, camera] = partner
    xy, covariance = people.xy.copy(), people.covariance.copy()
    height, height_sd = people.height.copy(), people.height_sd.copy()
    a, b = covariance[time, slot], own.covariance[time, partner]
    gain = a @ np.linalg.inv(a + b)
    step = own.xy[time, partner] - xy[time, slot]
    xy[time, slot] += np.einsum("nij,nj->ni", gain, step)
    covariance[time, slot] = a - gain @ a
    wa, wb = height_sd[time, slot] ** -2, own.height_sd[time, partner] ** -2
    height[time, slot] = (wa * height[time, slot] + wb * own.height[time, partner]) / (wa + wb)
    height_sd[time, slot] = (wa + wb) ** -0.5
    lonely = own.valid.copy()
    lonely[time, partner] = False
    fresh = np.full((*lonely.shape, members.shape[2]), -1)
    fresh[:, :, camera] = np.where(lonely, np.arange(lonely.shape[1]), -1)
    valid = np.concatenate([people.valid, lonely], 1)
    # Pack the people of each frame to the front and cut the empty rest.
    order = np.argsort(~valid, axis=1, kind="stable")[:, : max(1, int(valid.sum(1).max()))]

    def packed(
        one: Shaped[np.ndarray, "frame person *of"], two: Shaped[np.ndarray, "frame own *of"]
    ) -> Shaped[np.ndarray, "frame merged *of"]:
        joined = np.concatenate([one, two], 1)
        return joined[np.arange(len(joined))[:, None], order]

    merged = GroundMap(
        packed(xy, own.xy),
        packed(covariance, own.covariance),
        packed(height, own.height),
        packed(height_sd, own.height_sd),
        packed(people.valid, lonely),
    )
    return merged, packed(members, fresh)


def smallest_boxes(grid: BoxGrid) -> Float[np.ndarray, " cam"]:
    """(C,) box height in pixels below which a camera hardly detects anybody (5 % quantile)."""
    tall = grid.bottom - grid.top
    return np.array(
        [
            np.quantile(t[v], 0.05) if v.any() else np.inf
            for t, v in zip(tall, grid.valid, strict=True)
        ]
    )


def seen_by_any(
    grid: BoxGrid,
    state: RigState,
    people: GroundMap,
    smallest: Float[np.ndarray, " cam"],
    *,
    without: int,
) -> Bool[np.ndarray, "frame person"]:
    """Whether a placed camera other than one should see each person.

    Args:
        grid: all boxes, for the image sizes.
        state: the rig.
        people: (T, N) map of people.
        smallest: (C,) box height in pixels below which a camera hardly detects anybody.
        without: the camera that does not count.

    Returns:
        (T, N) bool.
    """
    seen = np.zeros(people.valid.shape, bool)
    for camera in np.flatnonzero(state.placed):
        if camera != without:
            seen |= visible(
                state.parameters[camera],
                grid.size[camera],
                smallest[camera],
                people.xy,
                people.height,
                state.foot_offset,
            )
    return seen & people.valid
