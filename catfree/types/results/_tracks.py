"""`Tracks`: positions on the ground with identities."""

import os
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int, UInt64

from catfree.errors import InvalidInputError, needing
from catfree.types._archive import load_record, naming_file, save_arrays
from catfree.types._clock import Clock, clock_from_array, clock_to_array, require_clock
from catfree.types._detections import Detections, require_pandas
from catfree.types._sampling import select_rows
from catfree.types._scene import Plane
from catfree.types._validation import (
    as_count,
    as_float,
    as_integer,
    refuse,
    require_declared_types,
    require_finite,
    require_instance,
    require_shape,
)
from catfree.types.results._arrow_table import from_table, to_table

if TYPE_CHECKING:
    import pandas
    import pyarrow


_NOT_NEGATIVE = {
    "sigma": "a length",
    "design_sigma": "a length",
    "supporting_cameras": "a number of cameras",
    "whole_views": "a number of images",
}
_ROUNDED = 1 + 1e-5  # a correlation of 1 after rounding to single precision


class Origin(IntEnum):
    """The source of a track's position.

    Attributes:
        DETECTED: boxes of this frame.
        EXTENDED: the paper's extension of a track beyond its ends.
        INTERPOLATED: the frames before and after.
    """

    DETECTED = 0
    EXTENDED = 1
    INTERPOLATED = 2


class Tracks(eqx.Module):
    """Positions on the ground with identities, sorted by frame, then track.

    Attributes:
        frame: (M,) frame of each position.
        track_id: (M,) identity, counted from 0; -1 without tracking.
        position: (M, 3) on the ground plane, scene units.
        ground_xy: (M, 2) coordinates along the plane's basis P (`Pᵀ position`): x, y in meters
            for a metric scene with z up.
        sigma: (M,) ground uncertainty sqrt(trace(covariance) / 2) in scene units (Eq. sigma); inf,
            like the covariance, if too few cameras support the position.
        covariance: (M, 2, 2) of `ground_xy`, scene units squared; the paper's method: `Pᵀ Λ⁻¹ P`;
            evidence: smoothed over time, with sway, uneven ground and the error of the whole map.
        supporting_cameras: (M,) number of cameras that support the position.
        origin: (M,) `Origin` values.
        existence: (M,) probability that a person is there, or None if the method gives none.
        support: (M, C) row of the caller's `Detections` that shows the person in each camera, or
            -1. A detection supports at most one row. If several positions of the paper's method
            share a detection, `supporting_cameras` and `sigma` count it for all of them, and
            `support` assigns it to the position closest to its ray. (M, 0) if unknown, as in a CSV
            table.
        velocity: (M, 2) velocity of `ground_xy` in scene units per frame number; multiply by the
            frame rate for scene units per second. NaN if unknown: for positions without a track,
            and in the paper's method for tracks of one position. Evidence: smoothed over time;
            paper: difference of the neighboring positions.
        velocity_covariance: (M, 2, 2) covariance of `velocity`; NaN where `velocity` is; inf in
            the paper's method if it rests on a position with fewer than two cameras.
        cameras: (M,) uint64 bit set of the cameras whose box supports the position (bit c is camera
            c), in tracks read from a table; None if `support` is known, or both are unknown.
        clock: maps frame numbers to times, or None if unknown.
        design_sigma: (M,) how precisely the rig locates people there: the ground uncertainty from
            the boxes of one instant without occlusion, in scene units, without sway, uneven ground
            and the error of the map. None if the method does not compute it.
        whole_views: (M,) number of images that would show the whole body without occlusion, or
            None.
    """

    frame: Int[np.ndarray, " m"]
    track_id: Int[np.ndarray, " m"]
    position: Float[np.ndarray, "m 3"]
    ground_xy: Float[np.ndarray, "m 2"]
    sigma: Float[np.ndarray, " m"]
    covariance: Float[np.ndarray, "m 2 2"]
    supporting_cameras: Int[np.ndarray, " m"]
    origin: Int[np.ndarray, " m"]
    existence: Float[np.ndarray, " m"] | None
    support: Int[np.ndarray, "m cam"]
    velocity: Float[np.ndarray, "m 2"]
    velocity_covariance: Float[np.ndarray, "m 2 2"]
    cameras: UInt64[np.ndarray, " m"] | None
    clock: Clock | None = eqx.field(static=True)
    design_sigma: Float[np.ndarray, " m"] | None
    whole_views: Int[np.ndarray, " m"] | None

    def __init__(
        self,
        frame: Any,
        track_id: Any,
        position: Any,
        ground_xy: Any,
        sigma: Any,
        covariance: Any,
        supporting_cameras: Any,
        origin: Any,
        existence: Any = None,
        support: Any = None,
        velocity: Any = None,
        velocity_covariance: Any = None,
        cameras: Any = None,
        clock: Any = None,
        design_sigma: Any = None,
        whole_views: Any = None,
    ) -> None:
        """Validate and store.

        Args:
            frame: as the attribute, like all others.
            track_id: identities.
            position: points on the ground.
            ground_xy: their coordinates on it.
            sigma: ground uncertainty.
            covariance: of the coordinates.
            supporting_cameras: how many.
            origin: `Origin` values.
            existence: probabilities, or None.
            support: rows of the detections, or None if unknown.
            velocity: None if unknown.
            velocity_covariance: None if unknown.
            cameras: None if `support` is known, or both are unknown.
            clock: of the frame numbers.
            design_sigma: None if unknown.
            whole_views: None if unknown.

        Raises:
            InvalidInputError: naming the first column whose shape or type is wrong, or the first
                entry of `support` below -1.
        """
        self.frame = as_integer(frame, "frame")
        self.track_id = as_integer(track_id, "track_id")
        self.supporting_cameras = as_integer(supporting_cameras, "supporting_cameras")
        self.origin = as_integer(origin, "origin")
        self.position, self.ground_xy, self.sigma, self.covariance = (
            np.asarray(as_float(values)) for values in (position, ground_xy, sigma, covariance)
        )
        self.existence = None if existence is None else np.asarray(as_float(existence, "existence"))
        require_shape(self.frame, (None,), "frame")
        m = len(self.frame)
        blank = np.zeros((m, 0), np.int64)
        self.support = blank if support is None else as_integer(support, "support")
        unknown = np.full((m, 2, 2), np.nan)
        self.velocity = (
            unknown[:, 0] if velocity is None else np.asarray(as_float(velocity, "velocity"))
        )
        self.velocity_covariance = (
            unknown
            if velocity_covariance is None
            else np.asarray(as_float(velocity_covariance, "velocity_covariance"))
        )
        self.cameras = None if cameras is None else np.asarray(cameras)
        self.clock = require_clock(clock)
        self.design_sigma = (
            None if design_sigma is None else np.asarray(as_float(design_sigma, "design_sigma"))
        )
        self.whole_views = None if whole_views is None else as_integer(whole_views, "whole_views")
        self._check(m)

    def _check(self, m: int) -> None:
        shapes: dict[str, tuple[int | None, ...]] = {
            "frame": (m,), "track_id": (m,), "position": (m, 3), "ground_xy": (m, 2),
            "sigma": (m,), "covariance": (m, 2, 2), "supporting_cameras": (m,), "origin": (m,),
            "support": (m, None), "velocity": (m, 2), "velocity_covariance": (m, 2, 2),
        }  # fmt: skip
        optional = ("existence", "cameras", "design_sigma", "whole_views")
        shapes |= {name: (m,) for name in optional if getattr(self, name) is not None}
        if self.cameras is not None and self.cameras.dtype != np.uint64:
            raise InvalidInputError(
                f"cameras must be a bit set of type uint64, got {self.cameras.dtype}."
            )
        for name, shape in shapes.items():
            require_shape(getattr(self, name), shape, name)
        fault = "; it must be a row of the detections, or -1 for none."
        refuse(self.support < -1, self.support, "support", fault)

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Any) -> "Tracks":
        """Select rows by a slice, a boolean mask or an integer array."""
        return select_rows(self, len(self), rows)

    @property
    def time(self) -> Float[np.ndarray, " m"] | None:
        """(M,) float64 seconds of each position on the `clock`, or None without a clock."""
        return None if self.clock is None else self.clock.seconds(self.frame)

    def renumbered(self) -> "Tracks":
        """Number the tracks from 0 in the order in which they begin, and sort the rows.

        Tracks that begin in the same frame are ordered by sigma, so the numbers do not depend on
        the frame of reference or on the order of cameras and detections. Positions without a track
        keep -1.
        """
        by_start = np.lexsort((*self.ground_xy.T[::-1], self.sigma, self.frame))
        by_start = by_start[self.track_id[by_start] >= 0]
        track_ids, first, inverse = np.unique(
            self.track_id[by_start], return_index=True, return_inverse=True
        )
        rank = np.empty(len(track_ids), np.int64)
        rank[np.argsort(first)] = np.arange(len(track_ids))
        track_id = np.full(len(self), -1)
        track_id[by_start] = rank[inverse]
        return replace(self, track_id=track_id)[np.lexsort((track_id, self.frame))]

    def to_rows(self, xy: Any = None) -> Float[np.ndarray, "m 4"]:
        """Return (M, 4) rows [frame, id, x, y] for `cf.evaluation`, of `ground_xy` or `xy`.

        Raises:
            InvalidInputError: if `xy` is not (M, 2).
        """
        points = self.ground_xy if xy is None else as_float(xy)
        require_shape(points, (len(self), 2), "xy")
        return np.column_stack([self.frame, self.track_id, points]).astype(np.float64)

    def to_arrow(self, camera_names: Sequence[str] | None = None) -> "pyarrow.Table":
        """Return the table that other programs read; `docs/table.md` describes it.

        Columns: `time_s` in seconds on the clock, `frame`, `track_id`, ground coordinates `x`, `y`
            in scene units, velocity `vx`, `vy` in scene units per second, covariance `cov_xx`,
        `cov_xy`, `cov_yy` of x and y, `existence`, `sigma`, `origin` and `cameras`, the bit set of
        the cameras whose box supports the row. Unknown values are null: times and velocities
        without a clock, velocities of single positions, existence in the paper's method, cameras of
        tracks from CSV. The schema's metadata give units, frame of reference, clock and names.

        Args:
            camera_names: (C,) for the metadata, or None.

        Raises:
            MissingDependencyError: if pyarrow is not installed.
            InvalidInputError: if there are more than 64 cameras, or the number of names differs.
        """
        return to_table(vars(self), camera_names)

    @classmethod
    def from_arrow(cls, table: "pyarrow.Table", ground: Plane | None = None) -> "Tracks":
        """Invert `to_arrow` exactly, except for rounding of velocities.

        The table lacks `support` (which becomes (M, 0), with the bit sets in `cameras`),
        `velocity_covariance` (NaN) and `position`. `supporting_cameras` counts the bits of
        `cameras`, and is 0 where they are unknown.

        Args:
            table: with its metadata; rows may have been selected, sorted or concatenated.
            ground: the ground plane of the scene, which gives `position`; NaN if None.

        Raises:
            MissingDependencyError: if pyarrow is not installed.
            InvalidInputError: if it is not an Arrow table, a value in it is out of range, or ground
                is not a `Plane`.
            FileFormatError: if it lacks a column, a value or its metadata.
        """
        if ground is not None:
            require_instance(ground, Plane, "ground")
        columns = from_table(table)
        flat = np.zeros((len(columns["frame"]), 3))
        tracks = cls(position=flat, **columns)
        require_sound_tracks(tracks)
        if ground is None:
            return replace(tracks, position=np.full_like(flat, np.nan))
        normal, basis = (np.asarray(v, np.float64) for v in (ground.normal, ground.basis))
        position = tracks.ground_xy @ basis.T - float(ground.offset) * normal
        return replace(tracks, position=position)

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the columns of `to_arrow` as a pandas table.

        Raises:
            MissingDependencyError: if pandas or pyarrow is not installed.
            InvalidInputError: if there are more than 64 cameras.
        """
        require_pandas()
        return self.to_arrow().to_pandas()

    def to_supervision(self, camera: int, detections: Detections) -> dict[int, Any]:
        """Return the tracked boxes of one camera as `supervision.Detections`, by frame.

        Each box has its person's `track_id`, the same in all cameras, as `tracker_id`, and
        `ground_xy` and `sigma` in `data`. Boxes without a track are left out.

            boxes = tracks.to_supervision(0, detections)
            annotated = supervision.BoxAnnotator().annotate(image, boxes[frame])

        Args:
            camera: index of the camera.
            detections: those that the tracks were made from.

        Returns:
            A dictionary from frame number to boxes, for each frame of the detections or tracks.

        Raises:
            MissingDependencyError: if supervision is not installed.
            InvalidInputError: if the tracks do not know their supporting boxes, as after reading
                them from a table, the camera does not exist, or the detections differ.
        """
        with needing("supervision.Detections need supervision: pip install 'catfree[bridges]'."):
            import supervision
        index = as_count(camera, "camera")
        if len(self) and not 0 <= index < self.support.shape[1]:
            raise InvalidInputError(
                f"There is no camera {index}; the tracks have boxes of {self.support.shape[1]} "
                "cameras."
            )
        kept = self[self.track_id >= 0]
        row, cameras, box = supporting_boxes(kept, detections)
        row, box = row[cameras == index], box[cameras == index]
        by_frame = np.argsort(kept.frame[row], kind="stable")
        row, box = row[by_frame], box[by_frame]
        frames = np.unique(np.concatenate([detections.frame, self.frame]))
        begin, end = (np.searchsorted(kept.frame[row], frames, side) for side in ("left", "right"))
        score = detections.score
        result = {}
        for frame, first, stop in zip(frames.tolist(), begin, end, strict=True):
            rows, boxes = row[first:stop], box[first:stop]
            result[frame] = supervision.Detections(
                xyxy=detections.box[boxes],
                confidence=None if score is None else score[boxes],
                tracker_id=kept.track_id[rows],
                data={"ground_xy": kept.ground_xy[rows], "sigma": kept.sigma[rows]},
            )
        return result

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one `.npz` file (no pickle).

        Raises:
            InvalidInputError: if the folder does not exist.
            WriteError: if the disk is full or not writable.
        """
        save_arrays(path, "Tracks", vars(self) | {"clock": clock_to_array(self.clock)})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Tracks":
        """Read what `save` wrote.

        Raises:
            InvalidInputError: if there is no such file, or a number in it is out of range.
            FileFormatError: if the file holds something else.
        """
        # Files of version 0.1 lack support and velocity, and those of version 0.2 the clock.
        arrays = load_record(path, cls)
        with naming_file(path):
            clock = clock_from_array(arrays.pop("clock", None))
            require_declared_types(cls, arrays)
            tracks = cls(**arrays, clock=clock)
            require_sound_tracks(tracks)
        return tracks


def supporting_boxes(
    tracks: Tracks, detections: Detections
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Find the boxes that support tracks.

    Args:
        tracks: tracks with known `support`.
        detections: those that the tracks were made from.

    Returns:
        For each box, the row of the track that it supports, its camera, and its row in the
        detections, sorted by the first two.

    Raises:
        InvalidInputError: if the tracks do not know their supporting boxes, as after reading them
            from a table, or the detections differ.
    """
    require_instance(detections, Detections, "detections")
    if len(tracks) and not tracks.support.shape[1]:
        raise InvalidInputError(
            "These tracks do not say which boxes support them, as tracks from a table never do. "
            "Pass those of the localization, or read them with Tracks.load."
        )
    row, camera = np.nonzero(tracks.support >= 0)
    box = tracks.support[row, camera]
    known = box < len(detections)
    same = detections.camera[box[known]] == camera[known]
    same &= detections.frame[box[known]] == tracks.frame[row[known]]
    if not (known.all() and same.all()):
        raise InvalidInputError(
            "The tracks were made from other detections: a box that supports them is missing, or "
            "of another camera or frame. Pass the detections that the tracks were made from."
        )
    return row, camera, box


def require_sound_tracks(tracks: Tracks) -> None:
    """Raise unless tracks are finite and lengths, variances, counts and probabilities in range.

    A position with fewer than two supporting cameras may have an infinite sigma, and velocities may
    be unknown (NaN), with unknown or infinite covariance.

    Raises:
        InvalidInputError: naming the first column and row.
    """
    unknown = np.isposinf(tracks.sigma) & (tracks.supporting_cameras < 2)
    for name in ("position", "ground_xy", "existence", "design_sigma"):
        if getattr(tracks, name) is not None:
            require_finite(getattr(tracks, name), name)
    for name in ("sigma", "covariance"):
        require_finite(getattr(tracks, name), name, ~unknown)
    for name in ("covariance", "velocity_covariance"):
        entries = np.asarray(getattr(tracks, name))
        negative = (entries < 0) & (np.eye(2, dtype=bool) | np.isinf(entries))
        require(~negative, entries, name, "a variance")
        deviation = np.sqrt(np.diagonal(entries, axis1=1, axis2=2))
        with np.errstate(invalid="ignore"):  # infinity times 0 allows everything
            most = _ROUNDED * deviation[:, :, None] * deviation[:, None]
        require(~(np.abs(entries) > most), entries, name, "a covariance that its variances allow")
    velocity = np.asarray(tracks.velocity)
    half_known = np.isnan(velocity) & np.isfinite(velocity[:, ::-1])
    sound = ~(np.isinf(velocity) | half_known)
    require(sound, velocity, "velocity", "a velocity, or NaN if unknown")
    for name, meaning in _NOT_NEGATIVE.items():
        if getattr(tracks, name) is not None:
            values = np.asarray(getattr(tracks, name))
            require(values >= 0, values, name, meaning)
    require(np.isin(tracks.origin, list(Origin)), tracks.origin, "origin", "a known origin")
    if tracks.existence is not None:
        existence = np.asarray(tracks.existence)
        require((existence >= 0) & (existence <= 1), existence, "existence", "a probability")


def require(good: Any, values: Any, name: str, meaning: str) -> None:
    """Raise unless all values pass a check, naming the first that does not."""
    refuse(~good, values, name, f", not {meaning}.")
