"""What `localize` returns: every candidate with its fate, and the tracks."""

import os
from enum import IntEnum
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from catfree.errors import InvalidInputError
from catfree.types._archive import load_arrays, naming_file, save_arrays
from catfree.types._detections import Detections
from catfree.types._validation import as_count, as_float, as_integer, first_index, require_shape


class Fate(IntEnum):
    """What became of a candidate: accepted, recovered, or the first filter that removed it.

    Attributes:
        ACCEPTED: a position of a track, both methods.
        RECOVERED: brought back by the paper's recovery.
        RMS_GATE: the paper's angular consistency.
        UNCERTAINTY_FILTER: too uncertain: the paper's threshold on sigma; in the evidence method
            less likely than not to be right within `report_radius`.
        GROUND_FILTER: the paper's ground-distance threshold.
        SUPPORT_FILTER: too little weighted support, the paper's method.
        TEMPORAL_FILTER: no partner in neighbouring frames, the paper's method.
        SUPPRESSED: a better position stands in the same place, both methods.
        EXISTENCE: more speaks against a person than for one, evidence method.
        TRACKING: in no track that lasts, evidence method.
        WORKING_AREA: beyond the ground that the rig covers, evidence method.
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
    """Where a track's position comes from.

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
            cameras; evidence: of this frame's boxes alone, finite for one camera too.
        ground_distance: (H,) unsigned distance g of the position to the ground in scene units.
        rms_angle: (H,) RMS angular residual of its own rays in radians; NaN with the evidence
            method, which compares boxes, not rays.
        support: (H, C) index of the supporting detection of each camera, or -1.
        score: (H,) the paper's method: auxiliary score that breaks ties of suppression; evidence:
            log-odds that a person is there, from this frame alone.
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
        """Number of candidates of each fate, by its lower-case name."""
        return {fate.name.lower(): int((self.fate == fate).sum()) for fate in Fate}


class Tracks(eqx.Module):
    """Positions on the ground with identities, sorted by frame, then track.

    Attributes:
        frame: (M,) frame of each position.
        track_id: (M,) identity, counted from 0; -1 where no tracking was asked for.
        position: (M, 3) on the ground plane, scene units.
        ground_xy: (M, 2) coordinates along the plane's basis P (`Pᵀ position`): x, y in metres
            for a metric scene with z up.
        sigma: (M,) ground uncertainty sqrt(trace(covariance) / 2) in scene units (Eq. sigma).
        covariance: (M, 2, 2) of `ground_xy`, scene units squared; the paper's method: `Pᵀ Λ⁻¹ P`;
            evidence: smoothed over time, with sway, uneven ground and the error of the whole map.
        supporting_cameras: (M,) number of cameras that support the position.
        origin: (M,) `Origin` values.
        existence: (M,) probability that a person is there, or None where the method gives none.
        support: (M, C) row of the caller's `Detections` that shows the person in each camera, or
            -1. No detection shows two people: where positions of the paper's method share one, it
            is counted in `supporting_cameras` and `sigma` of all of them, and stands here for the
            one that its ray passes closest. (M, 0) where nobody kept it, as in a table of tracks.
        velocity: (M, 2) of `ground_xy`, scene units per frame number: times the frames per second
            it is per second if frames are numbered one by one. NaN where it is not known: for
            positions without tracks, and with the paper's method in tracks of one position.
            Evidence: smoothed over time; the paper's method: the difference of the positions before
            and after.
        velocity_covariance: (M, 2, 2) of `velocity`, NaN where that is; inf where a position that
            it rests on has fewer than two cameras, the paper's method.
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
        """The rows selected by a slice, a boolean mask or an integer array."""
        chosen = np.arange(len(self))[rows].reshape(-1)
        columns: dict[str, Any] = {
            name: None if value is None else value[chosen] for name, value in vars(self).items()
        }
        return Tracks(**columns)

    def renumbered(self) -> "Tracks":
        """The same tracks, numbered from 0 in the order in which they begin, rows sorted anew.

        Of tracks that begin in one frame, the one with the smaller sigma there comes first: neither
        the frame of reference nor the order of cameras and detections can be seen in the numbers.
        Positions without a track keep -1.
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
        """(M, 4) rows [frame, id, x, y] for `cf.evaluation`, with `ground_xy` or other `xy`."""
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
        # Imported here, because the checks name this type.
        from catfree.types._result_checks import require_declared_types, require_sound_tracks

        naming_file(path, lambda: require_declared_types(cls, arrays))
        tracks = cls(**arrays)
        naming_file(path, lambda: require_sound_tracks(tracks))
        return tracks


class Thresholds(eqx.Module):
    """Everything that was estimated from the sequence; None where a stage did not run.

    Attributes:
        tau_sigma: uncertainty threshold in scene units.
        tau_g: ground-distance threshold in scene units.
        tau_sigma_recovery: the same, estimated again by the recovery.
        tau_g_recovery: the same, estimated again by the recovery.
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
    """A label-free summary of how far to trust a run.

    Attributes:
        median_sigma: median sigma of the tracks in scene units (NaN without tracks).
        sigma_over_radius: the same over the paper's suppression radius, or over the radius within
            which the evidence method calls a position right (`report_radius`).
        fraction_recovered: share of the accepted candidates that the recovery brought back.
        fraction_extended: share of the track positions that no box of their frame supports: the
            paper's extensions, the evidence method's gaps.
        mean_supporting_cameras: cameras a position, on average.
        detections_used: share of the detections that support an accepted position.
        expected_precision: share of the reported positions that are right, by the method's own
            probabilities; None where it gives none.
        expected_recall: share of the people who are reported, by the same probabilities: whom no
            two boxes show is not counted. None where the method gives none.
        expected_moda: MODA at half a metre to expect, in percent; NaN where nothing can be said,
            None in results of earlier versions.
        moda_low: lower end of the 90 % interval of MODA.
        moda_high: its upper end.
        expectation_note: why nothing can be said, or None.
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
        detection_count: N, the number of the caller's detections, those that took no part
            included; 0 in files of version 0.1, which did not keep who is in which box.
        warnings: sentences about the input of `cf.run` that the reader should know first.
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
