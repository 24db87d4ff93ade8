"""What `localize` returns: every candidate with its fate, and the tracks."""

import os
from enum import IntEnum
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from catfree.types._archive import load_arrays, naming_file, save_arrays


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
    """

    frame: Int[np.ndarray, " m"]
    track_id: Int[np.ndarray, " m"]
    position: Float[np.ndarray, "m 3"]
    ground_xy: Float[np.ndarray, "m 2"]
    sigma: Float[np.ndarray, " m"]
    covariance: Float[np.ndarray, "m 2 2"]
    supporting_cameras: Int[np.ndarray, " m"]
    origin: Int[np.ndarray, " m"]
    existence: Float[np.ndarray, " m"] | None = None

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Any) -> "Tracks":
        """The rows selected by a slice, a boolean mask or an integer array."""
        chosen = np.arange(len(self))[rows].reshape(-1)
        columns: dict[str, Any] = {
            name: None if value is None else value[chosen] for name, value in vars(self).items()
        }
        return Tracks(**columns)

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
        optional = ("existence",)
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
        warnings: sentences about the input of `cf.run` that the reader should know first.
    """

    tracks: Tracks
    candidates: Candidates
    thresholds: Thresholds
    reliability: Reliability
    warnings: tuple[str, ...] = eqx.field(default=(), static=True)
