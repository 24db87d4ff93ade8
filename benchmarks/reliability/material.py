"""The checks' view of a reader, and the small world in valid files."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from catfree.methods.online import Tracker, TrackerState
from catfree.synthetic import make_world, ring
from catfree.types import (
    Candidates,
    Localization,
    Reliability,
    Rig,
    Thresholds,
    Tracks,
)


@dataclass(frozen=True)
class Reader:
    """A reader with valid input.

    Attributes:
        name: name of the content.
        write: puts valid input into an empty folder.
        read: reads that folder; None means "absent", which only the cache may return.
        kind: kind of content, which decides how to damage it: text, archive or binary.
        only: suffixes of the files to damage; all if empty.
        cached: whether a read must return the written value or None.
    """

    name: str
    write: Callable[[Path], Any]
    read: Callable[[Path], Any]
    only: tuple[str, ...] = ()
    cached: bool = False


class Material:
    """Content of the files: a small world and a possible result of localization."""

    def __init__(self, seed: int, cameras: int = 3) -> None:
        layout = ring(cameras, seed=seed, image_size=(320, 240), people=3)
        world = make_world(layout, seed, frames=8, people=3)
        self.scene, self.detections = world.true_scene, world.detections
        self.names = ("north", "east", "south", "west")[:cameras]
        self.rig = self.scene.rig
        self.localization = _result(cameras, len(self.detections))
        self.tracks = self.localization.tracks

    def lens_rig(self) -> Rig:
        """Add a little distortion to the rig, so that files contain coefficients."""
        lens = np.tile([-0.1, 0.01, 0.001, 0.002, 0.0], (self.rig.camera_count, 1))
        rig = self.rig
        return Rig(rig.K, rig.R, rig.t, rig.image_size, distortion=lens)

    def tracker_state(self) -> TrackerState:
        """Return a tracker's state after all instants but the last."""
        tracker = Tracker(self.scene, lag=1.0)
        for frame in range(7):
            tracker.update(self.detections[self.detections.frame == frame], frame / 2)
        return tracker.state


def _result(cameras: int, detection_count: int) -> Localization:
    """Make the result for two people who walk through eight frames, without running a method."""
    count = 16
    frame, person = np.divmod(np.arange(count), 2)
    xy = np.stack([0.3 * frame, 2.0 * person - 1], axis=-1)
    position, sigma = np.column_stack([xy, np.zeros(count)]), np.full(count, 0.1)
    tracks = Tracks(
        frame=frame,
        track_id=person,
        position=position,
        ground_xy=xy,
        sigma=sigma,
        covariance=np.tile(0.01 * np.eye(2), (count, 1, 1)),
        supporting_cameras=np.full(count, 2),
        origin=np.zeros(count, np.int64),
        existence=np.full(count, 0.9),
        velocity=np.zeros((count, 2)),
        velocity_covariance=np.tile(0.01 * np.eye(2), (count, 1, 1)),
    )
    known = frame % 2 == 0  # the other positions rest on one ray each
    candidates = Candidates(
        frame=frame,
        position=position,
        sigma=np.where(known, sigma, np.inf),
        ground_distance=np.where(known, 0.0, np.nan),
        rms_angle=np.where(known, 0.01, np.nan),
        support=np.full((count, cameras), -1),
        score=np.ones(count),
        fate=np.zeros(count, np.int64),
    )
    reliability = Reliability(
        median_sigma=0.1,
        sigma_over_radius=0.2,
        fraction_recovered=0.0,
        fraction_extended=0.0,
        mean_supporting_cameras=2.0,
        detections_used=0.9,
        expected_precision=0.9,
        expected_recall=0.8,
        expected_moda=70.0,
        moda_low=60.0,
        moda_high=80.0,
        ground_height=float("nan"),
        lens_bend=0.001,
        shift_over_radius=0.1,
        least_together=float("nan"),
        rig_sd_over_radius=0.1,
    )
    thresholds = Thresholds(0.5, 0.5, 0.4, 0.4, 80.0, 0.7, 0.3)
    return Localization(tracks, candidates, thresholds, reliability, detection_count)
