"""Results of `localize`: tracks, and every candidate with its fate."""

import os
from enum import IntEnum
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from catfree.errors import InvalidInputError, quoted
from catfree.types._archive import load_arrays, naming_file, save_arrays
from catfree.types._declared_types import require_declared_types
from catfree.types._detections import Detections
from catfree.types._validation import (
    as_count,
    as_float,
    as_integer,
    first_index,
    require_finite,
    require_shape,
)


class Fate(IntEnum):
    """The outcome of a candidate: accepted, recovered, or the first filter that removed it.

    Attributes:
        ACCEPTED: part of a track, both methods.
        RECOVERED: brought back by the paper's recovery.
        RMS_GATE: the paper's angular consistency.
        UNCERTAINTY_FILTER: too uncertain: the paper's threshold on sigma; in the evidence method
            less likely than not to be right within `report_radius`.
        GROUND_FILTER: the paper's ground-distance threshold.
        SUPPORT_FILTER: too little weighted support, the paper's method.
        TEMPORAL_FILTER: no partner in neighboring frames, the paper's method.
        SUPPRESSED: a better position is in the same place, both methods.
        EXISTENCE: the evidence against a person outweighs that for one, evidence method.
        TRACKING: not part of a lasting track, evidence method.
        WORKING_AREA: outside the ground that the rig covers, evidence method.
    """

    ACCEPTED = 0
    RECOVERED = 1
    RMS_GATE = 2
    UNCERTAINTY_FILTER = 3
    GROUND_FILTER = 4
    SUPPORT_FILTER = 5
    TEMPORAL_FILTER = 6
    SUPPRESSED = 7
    EXISTENCE = 8
    TRACKING = 9
    WORKING_AREA = 10


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


class Candidates(eqx.Module):
    """Every position hypothesis of a run, accepted or not.

    Attributes:
        frame: (H,) frame of each hypothesis.
        position: (H, 3) in scene units; the paper's method: free in 3-D; evidence: on the ground.
        sigma: (H,) ground uncertainty in scene units; the paper's method: Eq. sigma, inf below two
            cameras; evidence: from this frame's boxes only, finite for one camera, too.
        ground_distance: (H,) unsigned distance g of the position to the ground in scene units.
        rms_angle: (H,) RMS angular residual of the supporting rays in radians; NaN with the
            evidence method, which compares boxes, not rays.
        support: (H, C) index of the supporting detection of each camera, or -1.
        score: (H,) the paper's method: auxiliary score that breaks ties of suppression; evidence:
            log-odds that a person is there, from this frame only.
        fate: (H,) `Fate` values.
    """

    frame: Int[np.ndarray, " h"]
    position: Float[np.ndarray, "h 3"]
    sigma: Float[np.ndarray, " h"]
    ground_distance: Float[np.ndarray, " h"]
    rms_angle: Float[np.ndarray, " h"]
    support: Int[np.ndarray, "h cam"]
    score: Float[np.ndarray, " h"]
    fate: Int[np.ndarray, " h"]

    def __len__(self) -> int:
        return len(self.frame)

    def count_by_fate(self) -> dict[str, int]:
        """Count the candidates of each fate, by its lower-case name."""
        return {fate.name.lower(): int((self.fate == fate).sum()) for fate in Fate}


class Tracks(eqx.Module):
    """Positions on the ground with identities, sorted by frame, then track.

    Attributes:
        frame: (M,) frame of each position.
        track_id: (M,) identity, counted from 0; -1 without tracking.
        position: (M, 3) on the ground plane, scene units.
        ground_xy: (M, 2) coordinates along the plane's basis P (`Pᵀ position`): x, y in meters
            for a metric scene with z up.
        sigma: (M,) ground uncertainty sqrt(trace(covariance) / 2) in scene units (Eq. sigma).
        covariance: (M, 2, 2) of `ground_xy`, scene units squared; the paper's method: `Pᵀ Λ⁻¹ P`;
            evidence: smoothed over time, with sway, uneven ground and the error of the whole map.
        supporting_cameras: (M,) number of cameras that support the position.
        origin: (M,) `Origin` values.
        existence: (M,) probability that a person is there, or None if the method gives none.
        support: (M, C) row of the caller's `Detections` that shows the person in each camera, or
            -1. A detection supports at most one row. If several positions of the paper's method
            share one, `supporting_cameras` and `sigma` count it for all of them, and `support`
            assigns it to the position closest to its ray. (M, 0) if unknown, as in a CSV table.
        velocity: (M, 2) velocity of `ground_xy` in scene units per frame number; multiply by the
            frame rate for scene units per second. NaN if unknown: for positions without a track,
            and in the paper's method for tracks of one position. Evidence: smoothed over time;
            paper: difference of the neighboring positions.
        velocity_covariance: (M, 2, 2) covariance of `velocity`; NaN where `velocity` is; inf in
            the paper's method if it rests on a position with fewer than two cameras.
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
            support: rows of the detections; None where they are not known.
            velocity: None where it is not known.
            velocity_covariance: None where it is not known.

        Raises:
            InvalidInputError: naming the first column whose shape does not fit the others, or the
                first entry of `support` below -1.
        """
        self.frame, self.track_id, self.origin = frame, track_id, origin
        self.position, self.ground_xy = position, ground_xy
        self.sigma, self.covariance = sigma, covariance
        self.supporting_cameras, self.existence = supporting_cameras, existence
        m = len(frame)
        blank = np.zeros((m, 0), np.int64)
        self.support = blank if support is None else as_integer(support, "support")
        unknown = np.full((m, 2, 2), np.nan)
        self.velocity = unknown[:, 0] if velocity is None else np.asarray(as_float(velocity))
        self.velocity_covariance = (
            unknown if velocity_covariance is None else np.asarray(as_float(velocity_covariance))
        )
        self._check(m)

    def _check(self, m: int) -> None:
        shapes: dict[str, tuple[int | None, ...]] = {
            "frame": (m,), "track_id": (m,), "position": (m, 3), "ground_xy": (m, 2),
            "sigma": (m,), "covariance": (m, 2, 2), "supporting_cameras": (m,), "origin": (m,),
            "support": (m, None), "velocity": (m, 2), "velocity_covariance": (m, 2, 2),
        }  # fmt: skip
        if self.existence is not None:
            shapes["existence"] = (m,)
        for name, shape in shapes.items():
            require_shape(getattr(self, name), shape, name)
        if (self.support < -1).any():
            at = first_index(self.support < -1)
            raise InvalidInputError(
                f"support[{at}] is {self.support[self.support < -1][0]}; it must be a row of the "
                "detections, or -1 for none."
            )

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Any) -> "Tracks":
        """Select rows by a slice, a boolean mask or an integer array."""
        chosen = np.arange(len(self))[rows].reshape(-1)
        columns: dict[str, Any] = {
            name: None if value is None else value[chosen] for name, value in vars(self).items()
        }
        return Tracks(**columns)

    def renumbered(self) -> "Tracks":
        """Number the tracks from 0 in the order in which they begin, and sort the rows.

        Tracks that begin in the same frame are ordered by sigma, so the numbers do not depend on
        the frame of reference or on the order of cameras and detections. Positions without a track
        keep -1.
        """
        by_start = np.lexsort((*self.ground_xy.T[::-1], self.sigma, self.frame))
        by_start = by_start[self.track_id[by_start] >= 0]
        known, first, place = np.unique(
            self.track_id[by_start], return_index=True, return_inverse=True
        )
        rank = np.empty(len(known), np.int64)
        rank[np.argsort(first)] = np.arange(len(known))
        track_id = np.full(len(self), -1)
        track_id[by_start] = rank[place]
        columns: dict[str, Any] = vars(self) | {"track_id": track_id}
        return Tracks(**columns)[np.lexsort((track_id, self.frame))]

    def to_rows(self, xy: Any = None) -> Float[np.ndarray, "m 4"]:
        """Return (M, 4) rows [frame, id, x, y] for `cf.evaluation`, of `ground_xy` or `xy`."""
        points = self.ground_xy if xy is None else np.asarray(xy)
        return np.column_stack([self.frame, self.track_id, points]).astype(np.float64)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one `.npz` file (no pickle)."""
        save_arrays(path, "Tracks", vars(self))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Tracks":
        """Read what `save` wrote.

        Raises:
            InvalidInputError: if there is no such file, or a number in it is out of range.
            FileFormatError: if the file holds something else.
        """
        # Files of version 0.1 lack the last three.
        optional = ("existence", "support", "velocity", "velocity_covariance")
        required = [name for name in cls.__annotations__ if name not in optional]
        arrays = load_arrays(path, "Tracks", required=required, optional=optional)
        naming_file(path, lambda: require_declared_types(cls, arrays))
        tracks = cls(**arrays)
        naming_file(path, lambda: require_sound_tracks(tracks))
        return tracks


class Thresholds(eqx.Module):
    """Values estimated from the sequence; None if a stage did not run.

    Attributes:
        tau_sigma: uncertainty threshold in scene units.
        tau_g: ground-distance threshold in scene units.
        tau_sigma_recovery: `tau_sigma` as the recovery estimates it again.
        tau_g_recovery: `tau_g` as the recovery estimates it again.
        median_box_height: h tilde in pixels.
        pose_ratio: weight of rays without confirmed ankles, min(1, (s_pose / s_other)²).
        extension_appearance: largest appearance distance that an extension accepts.
    """

    tau_sigma: float | None = None
    tau_g: float | None = None
    tau_sigma_recovery: float | None = None
    tau_g_recovery: float | None = None
    median_box_height: float | None = None
    pose_ratio: float | None = None
    extension_appearance: float | None = None


class Reliability(eqx.Module):
    """A label-free summary of the reliability of a run.

    Attributes:
        median_sigma: median sigma of the tracks in scene units (NaN without tracks).
        sigma_over_radius: `median_sigma` divided by the paper's suppression radius, or by the
            radius within which the evidence method counts a position as right (`report_radius`).
        fraction_recovered: share of the accepted candidates that the recovery brought back.
        fraction_extended: share of the track positions that no box of their frame supports: the
            paper's extensions, the evidence method's gaps.
        mean_supporting_cameras: mean number of cameras per position.
        detections_used: share of the detections that support an accepted position.
        expected_precision: expected share of the reported positions that are right, from the
            method's probabilities; None if it gives none.
        expected_recall: expected share of people who are reported, from the same probabilities,
            not counting people in fewer than two boxes; None if the method gives none.
        expected_moda: expected MODA at half a meter, in percent; NaN if it cannot be estimated,
            None in results of earlier versions.
        moda_low: lower end of the 90 % interval of MODA.
        moda_high: upper end of that interval.
        expectation_note: why MODA cannot be estimated, or None.
    """

    median_sigma: float
    sigma_over_radius: float
    fraction_recovered: float
    fraction_extended: float
    mean_supporting_cameras: float
    detections_used: float
    expected_precision: float | None = None
    expected_recall: float | None = None
    expected_moda: float | None = None
    moda_low: float | None = None
    moda_high: float | None = None
    expectation_note: str | None = eqx.field(default=None, static=True)


class Localization(eqx.Module):
    """The result of `cf.localize`.

    Attributes:
        tracks: positions on the ground with identities.
        candidates: every hypothesis and its fate.
        thresholds: what was estimated from the sequence.
        reliability: label-free summary.
        detection_count: N, the number of the caller's detections, including unused ones; 0 in
            files of version 0.1, which do not store which box shows whom.
        warnings: sentences about problems with the input of `cf.run`.
    """

    tracks: Tracks
    candidates: Candidates
    thresholds: Thresholds
    reliability: Reliability
    detection_count: int
    warnings: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        tracks: Tracks,
        candidates: Candidates,
        thresholds: Thresholds,
        reliability: Reliability,
        detection_count: int = 0,
        warnings: tuple[str, ...] = (),
    ) -> None:
        """Validate and store.

        Args:
            tracks: as the attribute, like all others.
            candidates: hypotheses.
            thresholds: estimates.
            reliability: the summary.
            detection_count: N.
            warnings: sentences.

        Raises:
            InvalidInputError: if the tracks are supported by a detection that there is not.
        """
        self.tracks, self.candidates = tracks, candidates
        self.thresholds, self.reliability = thresholds, reliability
        self.detection_count = as_count(detection_count, "detection_count")
        self.warnings = tuple(warnings)
        beyond = tracks.support >= self.detection_count
        if beyond.any():
            raise InvalidInputError(
                f"tracks.support[{first_index(beyond)}] is {tracks.support[beyond][0]}, but there "
                f"are {self.detection_count} detections. Pass their number as detection_count."
            )

    @property
    def identity(self) -> Int[np.ndarray, " n"]:
        """(N,) the track of each of the caller's detections, or -1: `tracks.support` inverted."""
        row, camera = np.nonzero(self.tracks.support >= 0)
        identity = np.full(self.detection_count, -1)
        identity[self.tracks.support[row, camera]] = self.tracks.track_id[row]
        return identity

    def require_detections(self, detections: Detections) -> None:
        """Raise unless these can be the detections that the result was made from.

        Raises:
            InvalidInputError: if their number is another.
        """
        if len(detections) != self.detection_count:
            raise InvalidInputError(
                f"The localization was made from {self.detection_count} detections, not from these "
                f"{len(detections)}. Pass the detections that it was made from; if a file of "
                "version 0.1 holds it, run `localize` again."
            )


def require_sound_tracks(tracks: Tracks) -> None:
    """Raise unless tracks are finite, with lengths and probabilities in range.

    A position that fewer than two cameras support may have an infinite sigma.

    Raises:
        InvalidInputError: naming the first column and row.
    """
    unknown = np.isposinf(tracks.sigma) & (tracks.supporting_cameras < 2)
    for name in ("position", "ground_xy", "existence"):
        if getattr(tracks, name) is not None:
            require_finite(getattr(tracks, name), name)
    for name in ("sigma", "covariance"):
        require_finite(getattr(tracks, name), name, ~unknown)
    _require((np.asarray(tracks.sigma) >= 0), tracks.sigma, "sigma", "a length")
    _require(np.isin(tracks.origin, list(Origin)), tracks.origin, "origin", "a known origin")
    if tracks.existence is not None:
        existence = np.asarray(tracks.existence)
        _require((existence >= 0) & (existence <= 1), existence, "existence", "a probability")


def require_sound_localization(localization: Localization) -> None:
    """Raise unless `localize` could have returned this result.

    Raises:
        InvalidInputError: naming the first field or row.
    """
    require_sound_tracks(localization.tracks)
    candidates = localization.candidates
    for name in ("position", "ground_distance", "score"):
        require_finite(getattr(candidates, name), f"candidates.{name}")
    _require(~np.isnan(candidates.sigma), candidates.sigma, "candidates.sigma", "a length")
    _require(np.isin(candidates.fate, list(Fate)), candidates.fate, "candidates.fate", "a fate")


def _require(good: Any, values: Any, name: str, meaning: str) -> None:
    if not np.all(good):
        at = first_index(~good)
        raise InvalidInputError(f"{name}[{at}] is {quoted(values[~good][0])}, not {meaning}.")
