"""One instant: group its boxes with the existing tracks as priors, and update the tracks."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from catfree.methods.evidence.group._appearance import PairRatios
from catfree.methods.evidence.group._groups import Priors, priors_of
from catfree.methods.evidence.observe._boxes import LONGEST_PAUSE
from catfree.methods.evidence.observe._measurement import Noise
from catfree.methods.evidence.observe._visibility import (
    count_detections,
    expected_views,
    rate_of_counts,
)
from catfree.methods.evidence.passes._follow_people import evidence_of_rows
from catfree.methods.evidence.passes._group_boxes import group_boxes
from catfree.methods.evidence.passes._observe_boxes import observe_boxes
from catfree.methods.evidence.passes._weigh_groups import judge, views_of_groups
from catfree.methods.evidence.report._uneven_ground import ground_shift
from catfree.methods.evidence.report._working_area import coverage_of
from catfree.methods.evidence.track._pasts import Pasts, SeenPositions, predict
from catfree.methods.evidence.track._presence import step_forward
from catfree.methods.evidence.track._suppress_overlapping import one_per_place
from catfree.methods.evidence.track._tracking import (
    CONSECUTIVE,
    Node,
    counted_steps,
    link,
    motion_of,
    sure_groups,
    transition,
)
from catfree.methods.online._learn import forgetting, likeness_of
from catfree.methods.online._tracker_state import Learned, PendingInstant, TrackerState, with_looks
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene


def usual_steps(learned: Learned, earlier: float, time: float) -> float:
    """Usual steps between two times; 0 if the earlier one is unknown."""
    if not np.isfinite(earlier):
        return 0.0
    return min((time - earlier) / float(learned.step), LONGEST_PAUSE)


def advance(
    state: TrackerState,
    detections: Detections,
    time: float,
    silent: Int[np.ndarray, " k"],
    scene: Scene,
    settings: EvidenceSettings,
) -> tuple[TrackerState, PendingInstant]:
    """Add an instant, once the unit is known.

    Args:
        state: the state after the previous instant.
        detections: usable boxes of the instant; frames are 0.
        time: seconds.
        silent: (K,) cameras without a picture.
        scene: rig and ground.
        settings: constants and switches.

    Returns:
        The state, whose window does not contain the instant yet, and the instant; its `support`
        refers to rows of `detections`.
    """
    learned = state.learned
    noise, unit = learned.noise, float(learned.unit)
    pictures = np.column_stack([np.zeros(len(silent), np.int64), silent])
    now = observe_boxes(
        detections, scene, unit, noise, settings, pictures, frames=np.zeros(1, np.int64)
    )
    embedding, likeness = now.boxes.embedding, likeness_of(learned, settings)
    if embedding is not None and likeness is not None:
        now = replace(now, ratios=PairRatios(embedding, likeness))
        state = with_looks(state, embedding.dim)

    motion = motion_of(learned.steps, settings)
    step = usual_steps(learned, float(state.time), time)
    heads = predict(state.heads, *transition(motion, step))
    rate = rate_of_counts(learned.heights, learned.trials, learned.hits, settings)
    priors = _priors(state, heads, noise, settings)
    now = group_boxes(replace(now, motion=motion, rate=rate), settings, priors)
    predicted = views_of_groups(now, settings)
    now = judge(now, predicted, settings, learned.clutter)
    boxes, views, groups, existence = now.boxes, now.views, now.groups, now.existence
    log_odds = existence.log_odds

    rows = np.flatnonzero(log_odds > -settings.evidence_limit / 2)
    population = now.population(settings, state.heads.looks.dim)
    looks = population.looks.at(slice(None))
    population = population._replace(looks=looks)
    node, followed, tracks = link(heads, groups.info[rows], rows, int(state.tracks), population)

    def of_tracks(values: Any, absent: int = 0) -> np.ndarray:
        """Take the values of each track's group, or a row of `absent` in a gap (group -1)."""
        columns = ((0, 0),) * (values.ndim - 1)
        return np.pad(values, ((0, 1), *columns), constant_values=absent)[node.group]

    trails = node.trails
    around = expected_views(trails.mean[:, :3], trails.frame, boxes, views, settings)
    evidence = evidence_of_rows(trails, now, settings)
    forward, weight = _carry(state, node.track, evidence, settings)
    shift = ground_shift(trails, now, settings)
    learned = forgetting(learned)
    active = learned.active | (groups.member >= 0).any(0)
    current = PendingInstant(
        time=np.array(time),
        node=node._replace(group=np.where(node.group >= 0, np.arange(len(node.group)), -1)),
        seen=jax.tree.map(of_tracks, SeenPositions(groups.info.matrix, groups.info.vector, looks)),
        evidence=evidence,
        forward=forward,
        weight=weight,
        shift=shift,
        place=coverage_of(node.mean[:, :3], around, active, views, noise, settings),
        support=np.append(boxes.row, -1)[of_tracks(groups.member, -1)],
    )

    cameras = int(active.sum())
    trials, hits = count_detections(predicted, groups.member, learned.heights, cameras, settings)
    sure = now.place[sure_groups(groups.member, log_odds, cameras, settings), :2]
    steps = learned.steps
    if 0 < step <= CONSECUTIVE:
        instant = np.repeat([0, 1], [len(state.sure), len(sure)])
        both = np.concatenate([state.sure, sure])
        steps = steps + counted_steps(both, instant, settings)
    learned = replace(
        learned,
        trials=learned.trials + trials,
        hits=learned.hits + hits,
        clutter=learned.clutter + existence.clutter,
        steps=steps,
        active=active,
    )
    alive = np.isin(node.track, followed.name)
    return replace(
        state,
        learned=learned,
        heads=followed,
        tracks=np.array(tracks),
        forward=forward[alive],
        weight=weight[alive],
        sure=sure,
    ), current


def _priors(state: TrackerState, heads: Pasts, noise: Noise, settings: EvidenceSettings) -> Priors:
    """Priors at the predicted places of people who are present, one per person."""
    present = state.forward[:, 0] > state.forward[:, 1]
    seen = np.where(heads.gap == 0, 0, -1)
    people = Node(heads.name, seen, heads.mean, heads.covariance).trails
    people = people[one_per_place(people, state.weight, present, settings.personal_space)]
    precision = np.linalg.inv(people.covariance[:, :3, :3])
    vector = np.einsum("nij,nj->ni", precision, people.mean[:, :3])
    return priors_of(people.frame, precision, vector, noise)


def _carry(
    state: TrackerState,
    track: Int[np.ndarray, " t"],
    evidence: Float[np.ndarray, " t"],
    settings: EvidenceSettings,
) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, " t"]]:
    """Advance presence and summed evidence of tracks; previously followed ones come first."""
    new = len(track) - len(state.weight)
    on = np.append(state.forward[:, 0], np.full(new, -np.inf))
    off = np.append(state.forward[:, 1], np.zeros(new))
    on, off = step_forward(on, off, evidence, settings.change_evidence)
    weight = np.append(state.weight, np.zeros(new)) + np.where(on > off, evidence, 0.0)
    return np.column_stack([on, off]), weight
