"""Results of `localize`: tracks, and every candidate with its fate."""

from enum import IntEnum

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from catfree.errors import InvalidInputError
from catfree.types._detections import Detections
from catfree.types._validation import as_count, refuse, require_finite
from catfree.types.results._tracks import Tracks, require, require_sound_tracks


class Fate(IntEnum):
    """The outcome of a candidate: accepted, recovered, or the first filter that removed it.

    Attributes:
        ACCEPTED: part of a track, both methods.
        RECOVERED: restored by the paper's recovery.
        RMS_GATE: the paper's angular consistency.
        UNCERTAINTY_FILTER: too uncertain: above the paper's threshold on sigma; in the evidence
            method, more likely than not off by more than `report_radius`.
        GROUND_FILTER: the paper's ground-distance threshold.
        SUPPORT_FILTER: too little weighted support, the paper's method.
        TEMPORAL_FILTER: no partner in neighboring frames, the paper's method.
        SUPPRESSED: a better position is at the same place, both methods.
        EXISTENCE: the evidence against a person outweighs that for one, evidence method.
        TRACKING: not part of a lasting track, evidence method.
        WORKING_AREA: outside the working area of the rig, evidence method.
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


class Candidates(eqx.Module):
    """Every position hypothesis of a run, accepted or not.

    Attributes:
        frame: (H,) frame of each hypothesis.
        position: (H, 3) in scene units; the paper's method: free in 3-D; evidence: on the ground.
        sigma: (H,) ground uncertainty of the supporting rays in scene units, Eq. sigma; inf with
            fewer than two rays.
        ground_distance: (H,) unsigned distance g in scene units from the ground to the intersection
            of the supporting rays; evidence: a diagnostic, NaN where sigma is inf.
        rms_angle: (H,) RMS angular residual of the supporting rays in radians; evidence: NaN where
            sigma is inf.
        support: (H, C) index of the supporting detection of each camera, or -1.
        score: (H,) the paper's method: auxiliary score that breaks ties in suppression; evidence:
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
        """Count the candidates of each fate, by its lower-case name."""
        return {fate.name.lower(): int((self.fate == fate).sum()) for fate in Fate}


class Thresholds(eqx.Module):
    """Values estimated from the sequence; None if a stage did not run.

    Attributes:
        tau_sigma: uncertainty threshold in scene units.
        tau_g: ground-distance threshold in scene units.
        tau_sigma_recovery: `tau_sigma` re-estimated by the recovery.
        tau_g_recovery: `tau_g` re-estimated by the recovery.
        median_box_height: h tilde in pixels.
        pose_ratio: weight of rays without confirmed ankles, min(1, (s_pose / s_other)²).
        extension_appearance: largest appearance distance that an extension accepts; inf if there
            was no data to learn it from.
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
        median_sigma: median sigma of the tracks in scene units (NaN without tracks, inf if most
            are).
        sigma_over_radius: `median_sigma` divided by the paper's suppression radius, or by the
            radius within which the evidence method counts a position as right (`report_radius`).
        fraction_recovered: share of the accepted candidates that the recovery restored.
        fraction_extended: share of the track positions without a supporting box in their frame: the
            paper's extensions, the evidence method's gaps.
        mean_supporting_cameras: mean number of cameras per position.
        detections_used: share of the detections that support an accepted position.
        expected_precision: expected share of the reported positions that are correct, from the
            method's probabilities; NaN without positions, None if the method has none.
        expected_recall: expected share of people who are reported, from the same probabilities, not
            counting people in fewer than two boxes; NaN without people, None if the method has
            none.
        expected_moda: expected MODA at half a meter, in percent; NaN if it cannot be estimated,
            None in results of earlier versions.
        moda_low: lower end of the 90 % interval of MODA; NaN if `expected_moda` is.
        moda_high: upper end of that interval.
        expectation_note: why MODA cannot be estimated, or None.
        ground_height: median height above the ground, in scene units, at which the foot rays of one
            person meet; negative if below; NaN for few people, None if the method does not estimate
            it.
        lens_bend: apparent error of a camera's lens model: the largest angle in radians between
            people near the border of its image and where the other cameras see them; 0 if not
            significant, None if the method does not estimate it.
        shift_over_radius: distance by which the clock error or the movement of a camera displaces
            people, maximum over cameras in whose residuals it shows clearly, divided by the same
            radius as sigma; None if the method does not estimate it.
        least_together: how often two cameras see a walking person together, relative to the rate
            expected if they missed people independently; minimum over pairs, NaN or None if
            unknown.
        rig_sd_over_radius: `Scene.rig_sd` divided by the same radius as sigma; None if unknown, or
            the method does not use it.
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
    ground_height: float | None = None
    lens_bend: float | None = None
    shift_over_radius: float | None = None
    least_together: float | None = None
    rig_sd_over_radius: float | None = None


class Localization(eqx.Module):
    """The result of `cf.localize`.

    Attributes:
        tracks: positions on the ground with identities.
        candidates: every hypothesis and its fate.
        thresholds: what was estimated from the sequence.
        reliability: label-free summary.
        detection_count: N, the number of the caller's detections, including unused ones; 0 in files
            of version 0.1, which do not store the identity of each box.
        warnings: sentences about problems with the input.
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
            InvalidInputError: if a supporting detection of the tracks does not exist.
        """
        self.tracks, self.candidates = tracks, candidates
        self.thresholds, self.reliability = thresholds, reliability
        self.detection_count = as_count(detection_count, "detection_count")
        self.warnings = tuple(warnings)
        fault = (
            f", but there are {self.detection_count} detections. Pass their number as "
            "detection_count."
        )
        refuse(tracks.support >= self.detection_count, tracks.support, "tracks.support", fault)

    @property
    def identity(self) -> Int[np.ndarray, " n"]:
        """(N,) the track of each of the caller's detections, or -1: `tracks.support` inverted."""
        row, camera = np.nonzero(self.tracks.support >= 0)
        identity = np.full(self.detection_count, -1)
        identity[self.tracks.support[row, camera]] = self.tracks.track_id[row]
        return identity

    def require_detections(self, detections: Detections) -> None:
        """Raise if the result cannot have been made from these detections.

        Raises:
            InvalidInputError: if their number differs.
        """
        if len(detections) != self.detection_count:
            raise InvalidInputError(
                f"The localization was made from {self.detection_count} detections, not from these "
                f"{len(detections)}. Pass the detections that it was made from; if a file of "
                "version 0.1 holds it, run `localize` again."
            )


def require_sound_localization(localization: Localization) -> None:
    """Raise unless `localize` could have returned this result.

    Raises:
        InvalidInputError: naming the first field or row.
    """
    require_sound_tracks(localization.tracks)
    candidates = localization.candidates
    for name in ("position", "score"):
        require_finite(getattr(candidates, name), f"candidates.{name}")
    sigma = candidates.sigma
    require(sigma >= 0, sigma, "candidates.sigma", "a length")
    for name, meaning in (("ground_distance", "a distance"), ("rms_angle", "an angle")):
        values = getattr(candidates, name)
        known = np.isfinite(values) | (np.isnan(values) & np.isposinf(sigma))
        require(known, values, f"candidates.{name}", meaning)
    require(np.isin(candidates.fate, list(Fate)), candidates.fate, "candidates.fate", "a fate")
    _require_sound_summary(localization)


def _require_sound_summary(localization: Localization) -> None:
    """Raise unless thresholds and reliability are finite, or unknown where allowed."""
    tracks, summary = localization.tracks, localization.reliability
    may_be_nan = {"expected_precision", "expected_recall", "expected_moda"}
    may_be_nan |= {"ground_height", "least_together", "median_sigma", "sigma_over_radius"}
    may_be_infinite = {"extension_appearance"}
    if np.isposinf(tracks.sigma).any():
        may_be_infinite |= {"median_sigma", "sigma_over_radius"}
    if summary.expected_moda is not None and np.isnan(summary.expected_moda):
        may_be_nan |= {"moda_low", "moda_high"}
    for part in ("reliability", "thresholds"):
        for name, value in vars(getattr(localization, part)).items():
            if value is None or isinstance(value, str) or np.isfinite(value):
                continue
            if name not in (may_be_nan if np.isnan(value) else may_be_infinite) or value < 0:
                raise InvalidInputError(f"{part}.{name} is {value}. Run `localize` again.")
