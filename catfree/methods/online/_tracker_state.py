"""The state of a `Tracker`."""

import hashlib
import os
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.errors import FileFormatError, InvalidInputError, quoted
from catfree.methods.evidence.group._appearance import no_looks
from catfree.methods.evidence.observe._ground_cells import CELLS
from catfree.methods.evidence.observe._measurement import Noise, start_noise
from catfree.methods.evidence.track._pasts import Pasts, SeenPositions, no_pasts
from catfree.methods.evidence.track._tracking import Node
from catfree.methods.online._sound_state import require_sound_arrays
from catfree.settings import EvidenceSettings
from catfree.types import Clock, Detections, Scene
from catfree.types._archive import load_arrays, save_arrays
from catfree.types._validation import as_count

M = TypeVar("M", Pasts, Node)
L = TypeVar("L", Pasts, SeenPositions)
TICKS = Clock(1_000_000)  # microseconds, the frame numbers of reported tracks
_SIZES = ("cameras", "window", "recording")  # counts stored in a file


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Learned:
    """What the boxes so far reveal about cameras and people; old instants count less and less.

    Attributes:
        unit: () H0 in scene units; NaN until boxes of standing people were seen.
        noise: noise of the boxes.
        step: () usual time between two instants in seconds; NaN before the second.
        heights: (C, 2) usual box heights.
        trials, hits: (C, 3, 5) people who should be detected, and who are.
        clutter: (2, C, cells, cells) boxes of people, and other boxes.
        steps: (2,) sum of squares and number of displacements between instants, per axis.
        likeness: (2, 2) mean and standard deviation of `Likeness.same` and `Likeness.other`; None
            without embeddings.
        places: (P, 4) position, design uncertainty and number of whole views of provisional people,
            inside or outside the working area.
        usual: (2,) `UsualPlace` of `places`; NaN while there are none.
        habits: (4,) counts of people who came or left, were reported, and hid; and of frames
            hidden.
        active: (C,) whether the camera ever saw anybody.
    """

    unit: Float[np.ndarray, ""]
    noise: Noise
    step: Float[np.ndarray, ""]
    heights: Float[np.ndarray, "cam 2"]
    trials: Float[np.ndarray, "cam 3 5"]
    hits: Float[np.ndarray, "cam 3 5"]
    clutter: Float[np.ndarray, "2 cam cells cells"]
    steps: Float[np.ndarray, "2"]
    likeness: Float[np.ndarray, "2 2"] | None
    places: Float[np.ndarray, "p 4"]
    usual: Float[np.ndarray, "2"]
    habits: Float[np.ndarray, "4"]
    active: Bool[np.ndarray, " cam"]


class PendingInstant(NamedTuple):
    """The T tracks of an instant that is not final yet, as in `Node`.

    Attributes:
        time: () seconds.
        node: the tracks; `node.group` is the row itself, or -1 in a gap.
        seen: positions according to the boxes.
        evidence: (T,) log-odds from the instant.
        forward: (T, 2) log weights of being present or not, given the instants so far.
        weight: (T,) summed evidence of the track while present, so far.
        shift: (T, 2) shift of the position per unit of ground height.
        place: (T, 2) as `EvidenceState.coverage`.
        support: (T, C) rows of the caller's detections, or -1.
    """

    time: Float[np.ndarray, ""]
    node: Node
    seen: SeenPositions
    evidence: Float[np.ndarray, " t"]
    forward: Float[np.ndarray, "t 2"]
    weight: Float[np.ndarray, " t"]
    shift: Float[np.ndarray, "t 2"]
    place: Float[np.ndarray, "t 2"]
    support: Int[np.ndarray, "t cam"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class TrackerState:
    """The state of a `Tracker`: a pytree of arrays whose size does not grow with time.

    With an infinite lag it does grow, because all boxes are kept until the end.

    Attributes:
        scene: () fingerprint of cameras and ground (`fingerprint_of`).
        count: () instants so far; `time`: () seconds of the last, minus infinity before the first.
        finished: () whether `finish` was called.
        learned: what is known about cameras and people.
        sample: boxes of a sample of recent instants to learn from; frames count instants.
        missing: (M, 2) instant and camera of missing pictures of the sample.
        spacing: () instants between those of the sample.
        times: (K,) seconds of the last instants.
        heads: the tracks being followed, T of them; `tracks`: () number of the next track.
        forward, weight: (T, 2) and (T,) of these tracks, as in `PendingInstant`.
        sure: (S, 2) certain positions of the last instant, in H0.
        window: the instants that are not final yet.
        pasts: final positions, by identity; `final_time`: () seconds of the last.
        identity: (K, 2) track and identity, for tracks that have one.
        names: () identities given so far.
        recording: boxes of all instants, only with an infinite lag; frames are microseconds.
        silent: (P, 2) missing pictures of all instants, likewise.
    """

    scene: Int[np.ndarray, ""]
    count: Int[np.ndarray, ""]
    time: Float[np.ndarray, ""]
    finished: Bool[np.ndarray, ""]
    learned: Learned
    sample: Detections
    missing: Int[np.ndarray, "missed 2"]
    spacing: Int[np.ndarray, ""]
    times: Float[np.ndarray, " k"]
    heads: Pasts
    tracks: Int[np.ndarray, ""]
    forward: Float[np.ndarray, "track 2"]
    weight: Float[np.ndarray, " track"]
    sure: Float[np.ndarray, "s 2"]
    window: tuple[PendingInstant, ...]
    pasts: Pasts
    final_time: Float[np.ndarray, ""]
    identity: Int[np.ndarray, "named 2"]
    names: Int[np.ndarray, ""]
    recording: tuple[Detections, ...]
    silent: Int[np.ndarray, "picture 2"]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one `.npz` file (no pickle); `load` returns it bit for bit.

        Raises:
            InvalidInputError: if the folder does not exist.
            WriteError: if the disk is full or not writable.
        """
        sizes = (len(self.learned.active), len(self.window), len(self.recording))
        arrays = dict(zip(_SIZES, sizes, strict=True))
        save_arrays(path, "TrackerState", arrays | dict(_leaves(self)))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "TrackerState":
        """Read what `save` wrote.

        Raises:
            InvalidInputError: if there is no such file.
            FileFormatError: if the file holds something else, or arrays that no tracker has.
        """
        arrays = load_arrays(path, "TrackerState", required=None)
        try:
            return _state_of(arrays)
        except InvalidInputError as error:
            raise FileFormatError(
                f"{path} is not the state of a tracker of this version: {error} Start a new "
                "tracker."
            ) from error


def _state_of(arrays: dict[str, np.ndarray]) -> TrackerState:
    """Make the state from these arrays and `_SIZES`.

    Raises:
        InvalidInputError: naming the first array that is missing, unknown or invalid.
    """
    missing = [name for name in _SIZES if name not in arrays]
    if missing:
        raise InvalidInputError(f"{missing[0]} is missing.")
    cameras, window, recording = (as_count(arrays[name], name, least=0) for name in _SIZES)
    for name, count in (("window", window), ("recording", recording)):
        start = f".{name}["
        indices = {key.partition("]")[0] for key in arrays if key.startswith(start)}
        if count != len(indices):
            raise InvalidInputError(f"{name} is {count}, but the file holds {len(indices)}.")
    empty = replace(
        new_state(0, EvidenceSettings(), 0),
        window=(_no_instant(0),) * window,
        recording=(no_boxes(),) * recording,
    )
    names = [name for name, _ in _leaves(empty)]
    unknown = arrays.keys() - {*names, *_SIZES}
    if unknown:
        raise InvalidInputError(f"It holds the unknown {quoted(min(unknown))}.")
    looks = arrays.get(".heads.looks.total", empty.heads.looks.total)
    dim = looks.shape[1] if looks.ndim == 2 else 0
    require_sound_arrays(arrays, empty, {"cam": cameras, "cells": CELLS, "dim": dim})
    _, kind = jax.tree.flatten(empty, is_leaf=_is_none)
    state = jax.tree.unflatten(kind, [arrays.get(name) for name in names])
    follows = [(state.heads.name, state.weight)]
    follows += [(instant.node.track, instant.weight) for instant in state.window]
    if any(len(tracks) != len(weights) for tracks, weights in follows):
        raise InvalidInputError("It holds different numbers of tracks and of their weights.")
    past, window = float(state.final_time), [float(instant.time) for instant in state.window]
    times = [*window] if np.isnan(past) else [past, *window]
    if (np.diff(times) <= 0).any() or max(times, default=-np.inf) > state.time:
        raise InvalidInputError("final_time, window and time are not in order.")
    return state


def _is_none(value: object) -> bool:
    return value is None


def _leaves(state: TrackerState) -> list[tuple[str, np.ndarray | None]]:
    leaves = jax.tree_util.tree_flatten_with_path(state, is_leaf=_is_none)[0]
    return [(jax.tree_util.keystr(place), leaf) for place, leaf in leaves]


def no_boxes() -> Detections:
    """Detections without rows."""
    none = np.zeros(0, np.int64)
    return Detections(none, none, np.zeros((0, 4)))


def fingerprint_of(scene: Scene) -> int:
    """Return 48 bits of the SHA-256 of a scene's cameras and ground, exact as a float."""
    digest = hashlib.sha256()
    for place, leaf in jax.tree_util.tree_flatten_with_path((scene.rig, scene.ground))[0]:
        digest.update(f"{jax.tree_util.keystr(place)} {np.shape(leaf)}".encode())
        digest.update(np.asarray(leaf, np.float64).tobytes())
    return int.from_bytes(digest.digest()[:6], "big")


def new_state(cameras: int, settings: EvidenceSettings, scene: int) -> TrackerState:
    """Return the state before any instant; `scene` is from `fingerprint_of`."""
    nan = np.array(np.nan)
    shape = (cameras, 3, 5)
    return TrackerState(
        scene=np.array(scene),
        count=np.array(0),
        time=np.array(-np.inf),
        finished=np.array(False),
        learned=Learned(
            unit=nan,
            noise=start_noise(cameras, settings),
            step=nan,
            heights=np.zeros((cameras, 2)),
            trials=np.zeros(shape),
            hits=np.zeros(shape),
            clutter=np.zeros((2, cameras, CELLS, CELLS)),
            steps=np.zeros(2),
            likeness=None,
            places=np.zeros((0, 4)),
            usual=np.full(2, np.nan),
            habits=np.zeros(4),
            active=np.zeros(cameras, bool),
        ),
        sample=no_boxes(),
        missing=np.zeros((0, 2), np.int64),
        spacing=np.array(1),
        times=np.zeros(0),
        heads=no_pasts(0),
        tracks=np.array(0),
        forward=np.zeros((0, 2)),
        weight=np.zeros(0),
        sure=np.zeros((0, 2)),
        window=(),
        pasts=no_pasts(0),
        final_time=nan,
        identity=np.zeros((0, 2), np.int64),
        names=np.array(0),
        recording=(),
        silent=np.zeros((0, 2), np.int64),
    )


def _no_instant(cameras: int) -> PendingInstant:
    none = np.zeros(0)
    five, square = np.zeros((0, 5)), np.zeros((0, 5, 5))
    integers = np.zeros(0, np.int64)
    return PendingInstant(
        np.zeros(()), Node(integers, integers, five, square),
        SeenPositions(square[:, :3, :3], five[:, :3], no_looks(0)), none, five[:, :2], none,
        five[:, :2], five[:, :2], np.zeros((0, cameras), np.int64),
    )  # fmt: skip


def rescaled(state: TrackerState, length: float, pace: float) -> TrackerState:
    """Convert a state to other units of length and time.

    Args:
        state: in the old units.
        length: old unit of length in new units.
        pace: new usual step divided by the old one; velocities per step grow by this factor.
    """
    if length == 1 and pace == 1:
        return state
    scale = length * np.array([1, 1, 1, pace, pace])
    square = scale[:, None] * scale

    def moved(known: M) -> M:
        return known._replace(mean=known.mean * scale, covariance=known.covariance * square)

    return replace(
        state,
        heads=moved(state.heads),
        sure=state.sure * length,
        window=tuple(
            i._replace(
                node=moved(i.node),
                seen=i.seen._replace(
                    matrix=i.seen.matrix / length**2, vector=i.seen.vector / length
                ),
                place=i.place * np.array([length, 1]),
            )
            for i in state.window
        ),
        pasts=moved(state.pasts),
    )


def with_looks(state: TrackerState, dim: int) -> TrackerState:
    """Add room for embeddings of `dim` numbers."""
    if state.heads.looks.dim == dim:
        return state

    def with_room(known: L) -> L:
        return known._replace(looks=no_looks(len(known.looks.boxes), dim))

    return replace(
        state,
        heads=with_room(state.heads),
        window=tuple(i._replace(seen=with_room(i.seen)) for i in state.window),
        pasts=with_room(state.pasts),
    )
