"""Tracks of people who each walk on a line, and their shards, made without boxes."""

import dataclasses
import itertools

import numpy as np

from catfree._run.sharded._receipt import files_of
from catfree._run.sharded._run_shard import _write_scene, write_shard
from catfree._run.sharded._shard import Shard
from catfree.methods.paper._assemble import empty_localization
from catfree.settings import Settings
from catfree.synthetic import make_layout
from catfree.types import Clock, Detections, Localization, Origin, Tracks

CLOCK = Clock(5.0)
SCENE = make_layout("ring4", 0).scene
CAMERAS = 4
NOISE = 0.02
HEIGHT = 1.7
BOXES = Detections([0] * CAMERAS, range(CAMERAS), [[0.0, 0, 1, 2]] * CAMERAS)  # of no person


def walks(rng, people, frames, apart=4.0):
    """Make people on lines `apart` meters from each other, each present for some time."""
    rows = []
    for person in range(people):
        length = rng.integers(min(20, frames), frames + 1)
        begin = rng.integers(0, frames - length + 1)
        frame = np.arange(begin, begin + length)
        x = 0.2 * (frame - begin) + np.cumsum(rng.normal(0, 0.02, length))
        rows.append(np.column_stack([frame, np.full(length, person), x, apart * person + 0 * x]))
    table = np.concatenate(rows)
    return tracks_of(table)


def tracks_of(rows):
    """Make tracks from rows frame, track, x, y."""
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    count = len(rows)
    return Tracks(
        frame=rows[:, 0].astype(np.int64),
        track_id=rows[:, 1].astype(np.int64),
        position=np.pad(rows[:, 2:], ((0, 0), (0, 1))),
        ground_xy=rows[:, 2:],
        sigma=np.full(count, NOISE),
        covariance=np.tile(NOISE**2 * np.eye(2), (count, 1, 1)),
        supporting_cameras=np.zeros(count, np.int64),
        origin=np.full(count, int(Origin.DETECTED)),
        existence=np.ones(count),
        support=np.full((count, CAMERAS), -1),
        clock=CLOCK,
    ).renumbered()


def plan_of(frames, length, margin):
    """Make shards of `length` frames, as `shards` cuts them."""
    count = max(1, int(frames / length + 0.5))
    cuts = [index * length for index in range(count)] + [frames]
    return [
        Shard(
            index, count, first, stop, max(first - margin, 0), min(stop + margin, frames), CLOCK,
            "a recording",
        )
        for index, (first, stop) in enumerate(itertools.pairwise(cuts))
    ]  # fmt: skip


def as_localization(tracks):
    nothing = empty_localization(CAMERAS)
    radius = Settings().evidence.report_radius * HEIGHT
    known = dataclasses.replace(
        nothing.reliability, median_sigma=NOISE, sigma_over_radius=NOISE / radius
    )
    return Localization(tracks, nothing.candidates, nothing.thresholds, known, CAMERAS)


def seen_by(shard, tracks, rng):
    """Return a shard's version of these tracks: other identities, and small errors."""
    part = tracks[(tracks.frame >= shard.first_seen) & (tracks.frame < shard.stop_seen)]
    names = rng.permutation(int(tracks.track_id.max(initial=0)) + 1)
    columns = {f.name: getattr(part, f.name) for f in dataclasses.fields(part)}
    columns["track_id"] = names[part.track_id]
    columns["ground_xy"] = part.ground_xy + rng.normal(0, NOISE / 10, part.ground_xy.shape)
    found = Tracks(**columns)
    return found[np.lexsort((found.track_id, found.frame))]


def write(out, shard, tracks, run="a run"):
    """Write a shard as `run_shard` does."""
    return write_shard(
        files_of(out, shard.index), shard, BOXES,
        as_localization(tracks), Settings(), run=run, scene_file=_write_scene(out, SCENE, None),
        seconds=0.0,
    )  # fmt: skip
