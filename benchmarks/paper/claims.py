"""Verdicts on the paper's claims, computed from the numbers: reproduced, in part, or not."""

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.paper.scoring import BLOCK, SAMPLES, Score
from catfree.evaluation import Interval

REPRODUCED = "reproduced"
CONDITIONAL = "reproduced only under conditions"
NOT_REPRODUCED = "not reproduced"
OPEN = "neither shown nor refuted"
UNTESTED = "not tested"


def difference(first: Score, second: Score) -> Interval:
    """Compute MODA of the first minus the second in points, with its 95 % interval.

    Blocks of successive frames are drawn with replacement, the same blocks for both.
    """
    one, two = first.detection, second.detection
    if not np.array_equal(one.frames, two.frames):
        raise ValueError("The two scores are of different frames.")
    wrong = (one.fp_per_frame + one.fn_per_frame) - (two.fp_per_frame + two.fn_per_frame)
    people = one.tp_per_frame + one.fn_per_frame
    count = len(people)
    block = max(1, min(BLOCK, count // 4))
    start = np.random.default_rng(0).integers(count, size=(SAMPLES, -(-count // block)))
    drawn = (start[..., None] + np.arange(block)).reshape(SAMPLES, -1)[:, :count] % count
    gains = -100 * wrong[drawn].sum(axis=1) / np.maximum(people[drawn].sum(axis=1), 1)
    low, high = np.quantile(gains, [0.025, 0.975])
    return Interval(float(low), float(high), float(-100 * wrong.sum() / max(people.sum(), 1)))


def higher(claim: str, gains: Mapping[str, Interval]) -> str:
    """Judge "the first is better than the second" from the gain in each case.

    A case supports the claim if the interval of its gain is above zero, contradicts it if the
    interval is below, and otherwise leaves it open. The claim is reproduced if some case supports
    it and none contradicts it.
    """
    outcome: dict[str, bool | None] = {
        place: None if gain.low <= 0 <= gain.high else gain.low > 0 for place, gain in gains.items()
    }
    return _sentence(claim, outcome, _texts(gains))


def not_lower(claim: str, gains: Mapping[str, Interval]) -> str:
    """Judge "it does no harm", which a gain whose interval reaches zero also supports."""
    return _sentence(claim, {p: gain.high >= 0 for p, gain in gains.items()}, _texts(gains))


def alike(claim: str, gains: Mapping[str, Interval], tolerance: float) -> str:
    """Judge "it changes nothing": all changes are within a tolerance in points."""
    holds = {place: abs(gain.value) <= tolerance for place, gain in gains.items()}
    return _sentence(f"{claim} (within {tolerance:g} points)", holds, _texts(gains))


def holds_in(claim: str, outcome: Mapping[str, bool], evidence: Mapping[str, str]) -> str:
    """Judge a claim that was decided case by case, each with its numbers."""
    return _sentence(claim, outcome, evidence)


def within(claim: str, paper: Mapping[str, float], worlds: Mapping[str, Sequence[float]]) -> str:
    """Judge the paper's own values: within, above or below the range of our worlds."""
    outcome, evidence = {}, {}
    for place, said in paper.items():
        low, high = min(worlds[place]), max(worlds[place])
        outcome[place] = low <= said <= high
        side = "inside" if outcome[place] else "above" if said > high else "below"
        evidence[place] = f"{said:.1f} {side} {low:.1f} to {high:.1f}"
    return _sentence(claim, outcome, evidence)


def _texts(gains: Mapping[str, Interval]) -> dict[str, str]:
    return {
        place: f"{gain.value:+.1f} [{gain.low:+.1f}, {gain.high:+.1f}]"
        for place, gain in gains.items()
    }


def _sentence(claim: str, outcome: Mapping[str, bool | None], evidence: Mapping[str, str]) -> str:
    """Format `Claim: verdict (where, with numbers)`; None is a case that leaves the claim open."""
    if not outcome:
        return f"{claim}: **{UNTESTED}**, no data."
    places: dict[bool | None, list[str]] = {True: [], False: [], None: []}
    for place, holds in outcome.items():
        places[holds].append(f"{place} ({evidence[place]})")
    parts = [
        f"{name} {', '.join(places[holds])}"
        for holds, name in ((True, "on"), (False, "not on"), (None, "open on"))
        if places[holds]
    ]
    verdict = {
        (True, True): CONDITIONAL,
        (True, False): REPRODUCED,
        (False, True): NOT_REPRODUCED,
        (False, False): OPEN,
    }[bool(places[True]), bool(places[False])]
    return f"{claim}: **{verdict}**: {'; '.join(parts)}."
