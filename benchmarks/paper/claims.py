"""Sentences on what the paper claims, written from the numbers: reproduced, in part, or not."""

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.paper.scoring import BLOCK, SAMPLES, Score
from catfree.evaluation import Interval

REPRODUCED = "reproduced"
CONDITIONAL = "reproduced only under conditions"
NOT_REPRODUCED = "not reproduced"


def difference(first: Score, second: Score) -> Interval:
    """MODA of the first minus the second in points, with its 95 % interval over the same frames.

    Blocks of successive frames are drawn with replacement, the same for both.
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
    """Verdict on "the first is better than the second", from the gain in each place.

    A place supports the claim if the gain is positive. The claim is reproduced if all places
    support it, only under conditions if some do; gains whose interval contains zero are named as
    such.
    """
    return _verdict(claim, {place: gain.value > 0 for place, gain in gains.items()}, gains)


def alike(claim: str, gains: Mapping[str, Interval], tolerance: float) -> str:
    """Verdict on "it changes nothing": the change is within a tolerance in points everywhere."""
    holds = {place: abs(gain.value) <= tolerance for place, gain in gains.items()}
    return _verdict(f"{claim} (within {tolerance:g} points)", holds, gains, sign_matters=False)


def holds_in(claim: str, outcome: Mapping[str, bool], evidence: Mapping[str, str]) -> str:
    """Verdict on a claim that was decided place by place, each with its numbers."""
    return _sentence(claim, outcome, evidence)


def within(claim: str, paper: Mapping[str, float], worlds: Mapping[str, Sequence[float]]) -> str:
    """Verdict on the paper's own values: inside the range of our worlds, or above or below it."""
    outcome, evidence = {}, {}
    for place, said in paper.items():
        low, high = min(worlds[place]), max(worlds[place])
        outcome[place] = low <= said <= high
        side = "inside" if outcome[place] else "above" if said > high else "below"
        evidence[place] = f"{said:.1f} {side} {low:.1f} to {high:.1f}"
    return _sentence(claim, outcome, evidence)


def _verdict(
    claim: str,
    outcome: Mapping[str, bool],
    gains: Mapping[str, Interval],
    *,
    sign_matters: bool = True,
) -> str:
    evidence = {}
    for place, gain in gains.items():
        unsure = sign_matters and gain.low <= 0 <= gain.high
        text = f"{gain.value:+.1f} [{gain.low:+.1f}, {gain.high:+.1f}]"
        evidence[place] = text + (", interval contains zero" if unsure else "")
    return _sentence(claim, outcome, evidence)


def _sentence(claim: str, outcome: Mapping[str, bool], evidence: Mapping[str, str]) -> str:
    """`Claim: verdict (where, with numbers)`."""
    if not outcome:
        return f"{claim}: **not tested**, no data."
    yes = [f"{place} ({evidence[place]})" for place, true in outcome.items() if true]
    no = [f"{place} ({evidence[place]})" for place, true in outcome.items() if not true]
    if not no:
        return f"{claim}: **{REPRODUCED}** on {', '.join(yes)}."
    if not yes:
        return f"{claim}: **{NOT_REPRODUCED}** on {', '.join(no)}."
    return f"{claim}: **{CONDITIONAL}**: on {', '.join(yes)}; not on {', '.join(no)}."
