"""Learn about cameras and people from the instants so far."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from catfree.errors import InsufficientDataError
from catfree.methods.evidence.group._appearance import Likeness, learn_ratios
from catfree.methods.evidence.learn._self_calibration import self_calibrate
from catfree.methods.evidence.passes._group_boxes import group_boxes
from catfree.methods.evidence.passes._observe_boxes import observe_boxes
from catfree.methods.evidence.passes._weigh_groups import weigh_groups
from catfree.methods.evidence.report._working_area import usual_place
from catfree.methods.online._tracker_state import Learned, TrackerState, rescaled
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene
from catfree.types._sampling import evenly_spread

SETTLED = 64  # instants after which earlier ones are not counted again; the batch limit is 60
INTERVAL = 512  # instants between later noise estimates, which follow slow changes
WIDEST_SPACING = 32  # largest spacing of the sample's instants; older ones are then forgotten
MEMORY = 2000.0  # instants after which a count weighs less by a factor of e
PLACES = 4096  # number of places of people to remember
FEW_PLACES = 512  # below this number, the usual place is learned at every instant
PLACES_INTERVAL = 16  # instants between later estimates of the usual place
USUAL_PLACES = 1024  # places used for each estimate, which takes a tenth of an instant's time
SAMPLED = ("frame", "camera", "box", "ankles_confirmed", "embedding")  # columns remembered
TIMES = 101  # instants whose median distance is the usual step


def add_to_sample(
    state: TrackerState,
    detections: Detections,
    silent: Int[np.ndarray, " k"],
    settings: EvidenceSettings,
) -> TrackerState:
    """Add an instant to the sample if it is due, dropping others to make room.

    Until it is full, the sample takes every instant. When full, it drops every other instant and
    from then on takes half as many, so that it covers the stream evenly. At the widest spacing, it
    drops the oldest instead. All instants have the same columns: those of the instants with most
    columns.
    """
    number, spacing = int(state.count), int(state.spacing)
    if number % spacing or len(detections) == 0:
        return state
    columns: dict[str, Any] = {name: getattr(detections, name) for name in SAMPLED}
    columns["frame"] = np.full(len(detections), number, np.int64)
    sample = Detections(**columns)
    if len(state.sample):
        old, new = (_present(of) for of in (state.sample, sample))
        if old - new:
            return state
        if old == new:
            sample = Detections.concatenate([state.sample, sample])
    frames = np.unique(sample.frame)
    if len(frames) > settings.calibration_frames:
        if spacing < WIDEST_SPACING:
            spacing *= 2
            sample = sample[sample.frame % spacing == 0]
        else:
            sample = sample[sample.frame > frames[0]]
    missing = np.concatenate(
        [state.missing, np.column_stack([np.full(len(silent), number), silent])]
    )
    missing = missing[np.isin(missing[:, 0], sample.frame)]
    return replace(state, sample=sample, missing=missing, spacing=np.array(spacing))


def _present(sample: Detections) -> set[str]:
    """List the columns of a sample."""
    return {name for name in SAMPLED if getattr(sample, name) is not None}


def is_due(count: int) -> bool:
    """Return whether to learn noise before an instant: often at first, then less and less often."""
    doubled = count & (count - 1) == 0
    return count > 0 and (doubled if count <= INTERVAL else count % INTERVAL == 0)


def learn_noise_and_unit(
    state: TrackerState, scene: Scene, settings: EvidenceSettings
) -> TrackerState:
    """Learn unit, noise, usual heights and likeness from the sample, as in batch."""
    learned, sample = state.learned, state.sample
    if len(sample) == 0:
        return state
    try:
        unit, noise = self_calibrate(sample, scene, settings)
    except InsufficientDataError:  # no whole person on the ground yet
        return state
    seen = observe_boxes(sample, scene, unit, noise, settings, state.missing)
    seen = group_boxes(seen, settings)
    ratios = learn_ratios(seen.boxes, seen.groups, settings)
    likeness = learned.likeness
    if ratios is not None:
        likeness = np.array([ratios.likeness.same, ratios.likeness.other])
    trials, hits, clutter = learned.trials, learned.hits, learned.clutter
    if state.count <= SETTLED:
        # Recount all instants so far: they were judged with less settled noise.
        seen = weigh_groups(replace(seen, ratios=ratios), settings)
        trials, hits, clutter = seen.rate.trials, seen.rate.hits, seen.existence.clutter
    old_unit = float(learned.unit)
    length = 1.0 if np.isnan(old_unit) else old_unit / unit
    learned = replace(
        learned,
        unit=np.array(unit),
        noise=jax.tree.map(np.asarray, noise),
        heights=seen.rate.heights,
        trials=trials,
        hits=hits,
        clutter=clutter,
        likeness=likeness,
        steps=learned.steps * np.array([length**2, 1]),
        places=learned.places * np.array([length, length, length, 1]),
        usual=learned.usual * np.array([length, 1]),
    )
    return rescaled(replace(state, learned=learned), length, 1.0)


def likeness_of(learned: Learned, settings: EvidenceSettings) -> Likeness | None:
    """The learned likeness of embeddings."""
    if learned.likeness is None:
        return None
    same, other = map(tuple, learned.likeness.tolist())
    return Likeness(same, other, settings.appearance_limit, settings.appearance_weight)


def learn_step(state: TrackerState, time: float) -> TrackerState:
    """Learn the usual time between instants, including this one."""
    times = np.append(state.times, time)[-TIMES:]
    old = new = float(state.learned.step)
    if len(times) > 1 and (np.isnan(old) or is_due(int(state.count))):
        new = float(np.median(np.diff(times)))
    pace = 1.0 if np.isnan(old) else new / old
    steps = state.learned.steps * np.array([pace**2, 1])
    learned = replace(state.learned, step=np.array(new), steps=steps)
    return rescaled(replace(state, times=times, learned=learned), 1.0, pace)


def learn_places(
    state: TrackerState, place: Float[np.ndarray, "n 4"], settings: EvidenceSettings
) -> TrackerState:
    """Add rows to `Learned.places`, and learn the usual place, rarely once many are known."""
    learned = state.learned
    places = np.concatenate([learned.places, place])[-PLACES:]
    usual = learned.usual
    often = len(learned.places) < FEW_PLACES or int(state.count) % PLACES_INTERVAL == 0
    if len(places) and often:
        some = evenly_spread(places, USUAL_PLACES)
        usual = np.array(usual_place(some[:, :2], some[:, 2:], settings))
    return replace(state, learned=replace(learned, places=places, usual=usual))


def forgetting(learned: Learned) -> Learned:
    """Decay all counts by one instant."""
    keep = np.exp(-1 / MEMORY)
    return replace(
        learned,
        trials=learned.trials * keep,
        hits=learned.hits * keep,
        clutter=learned.clutter * keep,
        steps=learned.steps * keep,
        habits=learned.habits * keep,
    )
