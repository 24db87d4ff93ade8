"""Finalize the oldest instants: smooth them with all later ones, and assign identities."""

from dataclasses import replace
from itertools import pairwise

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import expit

from catfree.methods.evidence._gaussian import Information
from catfree.methods.evidence.report._reported import Reported, no_rows
from catfree.methods.evidence.report._sharp_positions import sharp_positions
from catfree.methods.evidence.report._uneven_ground import usual_shift
from catfree.methods.evidence.report._working_area import UsualPlace
from catfree.methods.evidence.track._identify import (
    HORIZON,
    AbsenceHabits,
    ChainBoxes,
    futures_of,
    match_chains,
    seen_positions,
)
from catfree.methods.evidence.track._pasts import extend, predict
from catfree.methods.evidence.track._presence import presence
from catfree.methods.evidence.track._suppress_overlapping import one_per_place
from catfree.methods.evidence.track._tracking import (
    Population,
    Trails,
    motion_of,
    smooth,
    sure_groups,
    transition,
)
from catfree.methods.online._advance import usual_steps
from catfree.methods.online._learn import learn_places, likeness_of
from catfree.methods.online._tracker_state import TICKS, Learned, PendingInstant, TrackerState
from catfree.methods.online._update import Event
from catfree.settings import EvidenceSettings

# Prior counts of people who came or left, were reported, and hid; and of frames hidden.
USUAL_HABITS = np.array([4.0, 200.0, 4.0, 12.0])


def provisional(
    state: TrackerState, instant: PendingInstant, settings: EvidenceSettings
) -> tuple[TrackerState, Reported]:
    """Judge who is present now, and learn where people go; identities are track numbers."""
    node, learned = instant.node, state.learned
    log_odds = instant.forward[:, 0] - instant.forward[:, 1]
    # People seen by enough cameras are reported before their track has lasted.
    cameras = int(learned.active.sum())
    sure = sure_groups(instant.support, instant.evidence, cameras, settings)
    probability = expit(np.where(sure, np.maximum(log_odds, instant.evidence), log_odds))
    spread, sharp = sharp_positions(node.covariance, instant.shift, probability, settings)
    alone = one_per_place(node.trails, instant.weight, sharp, settings.personal_space)
    places = np.column_stack([node.mean[alone, :2], instant.place[alone]])
    state = learn_places(state, places, settings)
    rows = np.flatnonzero(alone & _in_working_area(instant.place, state.learned, settings))
    return state, Reported(
        TICKS.frame_at(np.full(len(rows), instant.time)), node.track[rows],
        node.mean[rows], node.covariance[rows, 3:, 3:], spread[rows], probability[rows],
        instant.support[rows], instant.place[rows],
    )  # fmt: skip


def with_identities(state: TrackerState, reported: Reported) -> tuple[TrackerState, Reported]:
    """Give provisional rows the current identities of their tracks, or new ones."""
    track = reported.identity
    names = _identity_of(state, track)
    unnamed = _by_precision(np.flatnonzero(names < 0), reported.position_covariance)
    names[unnamed] = int(state.names) + np.arange(len(unnamed))
    state = _named(state, track[unnamed], names[unnamed])
    return state, reported._replace(identity=names)


def _in_working_area(
    place: Float[np.ndarray, "n 2"], learned: Learned, settings: EvidenceSettings
) -> Bool[np.ndarray, " n"]:
    """Mark the positions in the working area, (n,); all positions until the area is known."""
    if not settings.working_area or not np.isfinite(learned.usual).all():
        return np.ones(len(place), bool)
    usual, cameras = UsualPlace(*learned.usual.tolist()), int(learned.active.sum())
    return usual.holds(place, cameras, settings)


def _by_precision(
    rows: Int[np.ndarray, " k"], covariance: Float[np.ndarray, "n 2 2"]
) -> Int[np.ndarray, " k"]:
    """Sort rows in an order that does not depend on the order of cameras or boxes."""
    return rows[np.argsort(np.trace(covariance[rows], axis1=1, axis2=2), kind="stable")]


def _identity_of(state: TrackerState, track: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """(n,) current identities of tracks, or -1."""
    identity_by_track = dict(state.identity.tolist())
    return np.array([identity_by_track.get(k, -1) for k in track.tolist()], np.int64)


def _named(
    state: TrackerState, track: Int[np.ndarray, " n"], name: Int[np.ndarray, " n"]
) -> TrackerState:
    """Assign identities to tracks; each identity belongs to one track."""
    old = state.identity
    stale = np.isin(old[:, 0], track) | np.isin(old[:, 1], name)
    identity = np.concatenate([old[~stale], np.column_stack([track, name])])
    names = max(int(state.names), int(name.max(initial=-1)) + 1)
    return replace(state, identity=identity, names=np.array(names))


def finalize(
    state: TrackerState, settings: EvidenceSettings, ready: int
) -> tuple[TrackerState, Reported, list[Event]]:
    """Finalize the first instants of the window.

    Args:
        state: with all instants so far in its window.
        settings: constants and switches.
        ready: number of instants to finalize.

    Returns:
        The state without these instants, their rows, and events.
    """
    if ready == 0:
        return state, no_rows(len(state.learned.active)), []
    window, learned = state.window, state.learned
    motion, noise = motion_of(learned.steps, settings), learned.noise
    spread = float(noise.spread)
    pauses = [usual_steps(learned, float(a.time), float(b.time)) for a, b in pairwise(window)]
    time = np.cumsum([0.0, *pauses])
    first = np.cumsum([0] + [len(i.node.track) for i in window])
    history = [
        i.node._replace(group=np.where(i.node.group >= 0, i.node.group + begin, -1))
        for i, begin in zip(window, first, strict=False)
    ]
    trails, row = smooth(history, time, motion)

    def column(name: str) -> np.ndarray:
        return np.concatenate([getattr(i, name) for i in window])

    def of_trails(name: str) -> np.ndarray:
        return column(name)[row]

    evidence, change = of_trails("evidence"), settings.change_evidence
    probability = presence(trails, evidence, change, of_trails("forward"))
    last = np.searchsorted(trails.track, trails.track, side="right") - 1  # row of its track
    weight = of_trails("weight")[last]
    seen = jax.tree.map(lambda *parts: np.concatenate(parts), *(i.seen for i in window))
    info = Information(seen.matrix, seen.vector, np.zeros(len(seen.matrix)))
    likeness = likeness_of(learned, settings) if settings.link_by_looks else None
    shift = usual_shift(trails, of_trails("shift"), settings.gap)
    covariance, sharp = sharp_positions(trails.covariance, shift, probability, settings)
    oldest = trails.frame < ready
    alone = one_per_place(trails, weight, sharp & oldest, settings.personal_space)
    sharp = np.where(oldest, alone, sharp)
    place, support = of_trails("place"), of_trails("support")
    reported = sharp & _in_working_area(place, learned, settings)
    extra = covariance - trails.covariance[:, :2, :2]
    walk = replace(motion, memory=motion.memory**settings.sudden)
    density = float(noise.density)
    population = Population(time, walk, density, spread, settings, seen.looks, likeness)
    identity, events = np.full(len(trails), -1), []
    for t in range(ready):
        now = reported & (trails.frame == t)
        state, identity[now], merged = _identify(
            state, float(window[t].time), trails, t, reported, extra, info, population
        )
        events += merged
        state = replace(state, final_time=window[t].time)
    rows = np.flatnonzero(reported & oldest)
    frame = TICKS.frame_at(np.array([i.time for i in window]))[trails.frame[rows]]
    final = Reported(
        frame, identity[rows], trails.mean[rows], trails.covariance[rows, 3:, 3:],
        covariance[rows], probability[rows], support[rows], place[rows],
    )  # fmt: skip
    return replace(state, window=window[ready:]), final, events


def _identify(
    state: TrackerState,
    time: float,
    trails: Trails,
    frame: int,
    reported: np.ndarray,
    extra: np.ndarray,
    info: Information,
    population: Population,
) -> tuple[TrackerState, Int[np.ndarray, " n"], list[Event]]:
    """Match the final positions so far with everything known from one frame on."""
    learned = state.learned
    motion = population.motion
    step = usual_steps(learned, float(state.final_time), time)
    pasts = predict(state.pasts, *transition(motion, step))
    rows = np.flatnonzero(reported & (trails.frame >= frame))
    rows = rows[np.argsort(trails.frame[rows], kind="stable")]
    seen = seen_positions(trails, rows, extra, info, population.looks)
    track, chain = np.unique(trails.track[rows], return_inverse=True)
    bounds = np.searchsorted(trails.frame[rows], np.arange(frame, len(population.time) + 1))
    at = [np.arange(a, b) for a, b in pairwise(bounds)]
    steps = [transition(motion, float(dt)) for dt in np.diff(population.time[frame:])]
    future = futures_of(at, seen, chain, steps)[0]
    ahead = ChainBoxes.of(seen, chain, len(track)).at(future.chain)
    past_of = np.full(len(track), -1)
    past_of[future.chain] = match_chains(pasts, future, ahead, _habits(learned.habits), population)
    frame_nodes = at[0]
    linked = past_of[chain[frame_nodes]]
    numbers = track[chain[frame_nodes]]
    previous = _identity_of(state, numbers)
    names = np.append(pasts.name, -1)[linked]
    # A track that continues no past keeps its identity, unless a past has taken it.
    free = (linked < 0) & (previous >= 0) & ~np.isin(previous, pasts.name)
    names[free] = previous[free]
    trail_rows = rows[frame_nodes]
    spread = extra[trail_rows] + trails.covariance[trail_rows, :2, :2]
    unnamed = _by_precision(np.flatnonzero(names < 0), spread)
    names[unnamed] = int(state.names) + np.arange(len(unnamed))
    events = [
        Event("merge", time, int(old), int(name))
        for old, name in zip(previous, names, strict=True)
        if old >= 0 and old != name and old not in pasts.name and old not in names
    ]
    hidden, begun = pasts.gap[linked[linked >= 0]], names[linked < 0]
    now = seen.at(frame_nodes)
    longer = extend(pasts, linked, begun, now, population.spread, motion.speed)
    longer = longer.seen_within(HORIZON - 1)
    departed = len(pasts.name) + len(begun) - len(longer.name)
    counted = np.array(
        [len(begun) + departed, len(frame_nodes), (hidden > 0).sum(), hidden.sum()], float
    )
    learned = replace(learned, habits=learned.habits + counted)
    state = _named(replace(state, pasts=longer, learned=learned), numbers, names)
    return state, names, events


def _habits(counts: Float[np.ndarray, "4"]) -> AbsenceHabits:
    """Estimate rates of leaving and hiding from counts, by Laplace's rule of succession."""
    moved, count, times, total = counts + USUAL_HABITS
    return AbsenceHabits(moved / (2 * count), times / count, max(total - times, 1) / total)


def forget_ended_tracks(state: TrackerState) -> TrackerState:
    """Forget the identities of tracks that are no longer referred to."""
    alive = [state.heads.name, *(i.node.track for i in state.window)]
    known = np.isin(state.identity[:, 0], np.concatenate(alive))
    return replace(state, identity=state.identity[known])
