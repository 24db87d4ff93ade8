"""Scores of one sequence or several pooled seeds, with bootstrap intervals over frames."""

import dataclasses
from collections.abc import Iterable
from functools import cache

import numpy as np
from jaxtyping import Float

import catfree as cf
from benchmarks.paper.sequences import Sequence
from benchmarks.paper.staged import localize_staged
from catfree.evaluation import (
    DetectionIntervals,
    DetectionMetrics,
    HotaMetrics,
    Interval,
    TrackingMetrics,
    align_centres,
    bootstrap,
    combine_detection,
    combine_hota,
    combine_tracking,
    crop,
    detection_metrics,
    hota,
    tracking_metrics,
)

BLOCK = 10  # successive frames drawn together: five seconds at two frames per second
SAMPLES = 2000


@dataclasses.dataclass(frozen=True)
class Score:
    """Metrics of one run, or of several pooled runs.

    Attributes:
        detection: MODA, MODP, precision and recall at 0.5 m.
        tracking: MOTA, MOTP and IDF1 at 1 m, or None without identities or tracks.
        hota: HOTA with the paper's point similarity, or None.
    """

    detection: DetectionMetrics
    tracking: TrackingMetrics | None = None
    hota: HotaMetrics | None = None

    @property
    def moda(self) -> float:
        """MODA in percent."""
        return float(self.detection.moda)

    @property
    def intervals(self) -> DetectionIntervals:
        """95 % intervals of the detection rates, drawing blocks of frames with replacement."""
        block = max(1, min(BLOCK, len(self.detection.frames) // 4))
        return bootstrap(self.detection, SAMPLES, block_length=block)

    @property
    def cell(self) -> Interval:
        """MODA with its interval, as a cell of a table."""
        return self.intervals.moda


def ground_rows(
    tracks: cf.Tracks, sequence: Sequence, scene: cf.Scene | None = None
) -> Float[np.ndarray, "m 4"]:
    """Return track rows in meters: as given in a metric scene, else aligned by the camera centers.

    Args:
        tracks: the result.
        sequence: sequence with the truth; only its true camera centers are used.
        scene: scene of the result; None for the sequence's own.

    Returns:
        (M, 4) rows [frame, id, x, y].
    """
    scene = sequence.scene if scene is None else scene
    if scene.metric or sequence.true_centres is None:
        return tracks.to_rows()
    align = align_centres(
        np.asarray(scene.rig.centers),
        sequence.true_centres,
        registered=np.asarray(scene.rig.registered),
    )
    return tracks.to_rows(np.asarray(align(tracks.position))[:, :2])


def world_covariance(tracks: cf.Tracks, sequence: Sequence) -> np.ndarray:
    """Return the (M, 2, 2) covariance in meters along the axes of the ground truth."""
    axes = np.asarray(sequence.scene.ground.basis)
    if not sequence.scene.metric and sequence.true_centres is not None:
        align = align_centres(np.asarray(sequence.scene.rig.centers), sequence.true_centres)
        origin = np.asarray(align(np.zeros((1, 3))))
        axes = (np.asarray(align(axes.T)) - origin).T
    return axes[:2] @ np.asarray(tracks.covariance) @ axes[:2].T


def score_rows(
    rows: Float[np.ndarray, "m 4"], sequence: Sequence, *, tracking: bool = True
) -> Score:
    """Score rows in meters, ignoring those outside the area, as the paper's evaluator does."""
    truth = sequence.ground_truth
    if sequence.area is not None:
        rows, truth = crop(rows, sequence.area), crop(truth, sequence.area)
    found = detection_metrics(truth, rows, sequence.frames)
    tracked = tracking and sequence.identified and (rows[:, 1] >= 0).all()
    if not tracked:
        return Score(found)
    return Score(
        found,
        tracking_metrics(truth, rows, sequence.frames),
        hota(truth, rows, sequence.frames),
    )


def score(
    localization: cf.Localization,
    sequence: Sequence,
    scene: cf.Scene | None = None,
    *,
    tracking: bool = True,
) -> Score:
    """Score a result, after the similarity alignment of camera centers if the rig is estimated.

    Args:
        localization: the result.
        sequence: sequence that was localized.
        scene: scene used instead of the sequence's, or None.
        tracking: whether to compute tracking metrics.

    Returns:
        The score.
    """
    rows = ground_rows(localization.tracks, sequence, scene)
    return score_rows(rows, sequence, tracking=tracking)


def pool(scores: Iterable[Score]) -> Score:
    """Pool the scores of several sequences: all counts are added, all frames resampled."""
    parts = list(scores)
    tracking = [part.tracking for part in parts if part.tracking is not None]
    hotas = [part.hota for part in parts if part.hota is not None]
    return Score(
        combine_detection(part.detection for part in parts),
        combine_tracking(tracking) if len(tracking) == len(parts) else None,
        combine_hota(hotas) if len(hotas) == len(parts) else None,
    )


@cache
def localize(
    sequence: Sequence, settings: cf.Settings, *, true_rig: bool = False
) -> cf.Localization:
    """Call `cf.localize` with a memory, because several tables need the same runs.

    Args:
        sequence: sequence to localize.
        settings: settings of the run.
        true_rig: whether to use the true scene instead of the recovered one.
    """
    scene = sequence.true_scene if true_rig else sequence.scene
    assert scene is not None
    return localize_staged(sequence, scene, settings)


@cache
def run(
    sequence: Sequence, settings: cf.Settings, *, true_rig: bool = False, tracking: bool = False
) -> Score:
    """Localize and score, with a memory."""
    scene = sequence.true_scene if true_rig else sequence.scene
    found = localize(sequence, settings, true_rig=true_rig)
    return score(found, sequence, scene, tracking=tracking)
