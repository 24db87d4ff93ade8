"""Learn what the embeddings of a sequence say about who is who."""

from dataclasses import replace

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.group._appearance import PairRatios, compare_frames, learn_ratio
from catfree.methods.evidence.group._group import group
from catfree.settings import EvidenceSettings


def learn_looks(state: EvidenceState, settings: EvidenceSettings) -> EvidenceState:
    """Learn the likelihood ratio of embeddings from boxes grouped by position and height."""
    appearance = compare_frames(state.boxes) if settings.use_appearance else None
    if appearance is None:
        return state
    groups = group(state.boxes, state.measurements, state.noise, settings.gate)
    likeness = learn_ratio(appearance, groups, settings)
    if likeness is None:
        return state
    return replace(state, ratios=PairRatios(appearance, likeness, settings.appearance_weight))
