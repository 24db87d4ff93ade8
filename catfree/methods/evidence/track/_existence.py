"""Log-odds that a group is a person, from the cameras that see it and those that should."""

from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float, Int
from scipy.special import expit

from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._ground_cells import CELLS
from catfree.methods.evidence.observe._visibility import Views
from catfree.settings import EvidenceSettings

CLUTTER_ROUNDS = 6  # of expectation maximization; five converge to a few percent


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Existence:
    """Evidence for and against each group.

    Attributes:
        log_odds: (H,) log-odds that a person is present.
        rate: (H, C) detection probability, 0 for cameras without a picture.
        clutter: (2, C, cells, cells) expected number of boxes of people, and of other boxes, in
            every cell of every camera.
    """

    log_odds: Float[np.ndarray, " group"]
    rate: Float[np.ndarray, "group cam"]
    clutter: Float[np.ndarray, "2 cam cells cells"]


def not_judged(groups: int, cameras: int) -> Existence:
    """Return the existence of groups before any evidence."""
    unknown = np.zeros((groups, cameras))
    return Existence(unknown.sum(1), unknown, np.zeros((2, cameras, CELLS, CELLS)))


def with_pictures(visibility: Views, frame: Int[np.ndarray, " person"], boxes: Boxes) -> Views:
    """Set the visibility to 0 where a picture is known to be missing."""
    return replace(visibility, inside=np.where(boxes.silent[frame], 0.0, visibility.inside))


def delivered(
    rate: np.ndarray, groups: Groups, boxes: Boxes, settings: EvidenceSettings
) -> np.ndarray:
    """Mark the frames that each camera delivered, (F, C).

    A frame without boxes although many people are expected counts as not delivered.
    """
    expected = np.zeros(boxes.table.shape[:2])
    strong = (groups.member >= 0).sum(1) >= 2
    np.add.at(expected, groups.frame[strong], rate[strong])
    empty = (boxes.table >= 0).sum(-1) == 0
    return ~(empty & (expected > settings.outage_expected))


def misses(rate: np.ndarray) -> np.ndarray:
    """(H,) sum of log(1 - Pd) over the cameras (H, C)."""
    return np.log1p(-rate).sum(1)


def judge_groups(
    groups: Groups,
    agreement: np.ndarray,
    cell: Int[np.ndarray, " box"],
    boxes: Boxes,
    probability: np.ndarray,
    usual: Float[np.ndarray, " cam"],
    settings: EvidenceSettings,
    clutter: Float[np.ndarray, "2 cam cells cells"] | None = None,
) -> Existence:
    """Compute the log-odds of every group, with given clutter or clutter learned from the groups.

    Args:
        groups: the groups.
        agreement: (H,) appearance term.
        cell: (N,) cell of each box in its camera's map: where the box alone places a person. False
            boxes recur at the same pixels, whatever they are grouped with.
        boxes: the boxes.
        probability: (H, C) detection probability of each group in each camera.
        usual: (C,) mean of it over the people whom each camera detects.
        settings: constants.
        clutter: as in `Existence`, from earlier boxes; None to learn it by expectation
            maximization.
    """
    member = groups.member
    pictured = delivered(probability, groups, boxes, settings)
    probability = probability * pictured[groups.frame]
    # Before learning, a box is as likely false as true.
    base = log_odds_without_clutter(groups.gain + agreement, member, probability, usual, settings)
    log_odds = base
    g, camera = np.nonzero(member >= 0)
    at, shape = camera * CELLS**2 + cell[member[g, camera]], (member.shape[1], CELLS, CELLS)

    def counted(log_odds: Float[np.ndarray, " group"]) -> Float[np.ndarray, "2 cam cells cells"]:
        """Expected number of boxes of people, and of other boxes, as in `Existence`."""
        is_person = expit(log_odds)[g]
        parts = (np.bincount(at, p, np.prod(shape)) for p in (is_person, 1 - is_person))
        return np.stack([part.reshape(shape) for part in parts]).astype(float)

    rounds = CLUTTER_ROUNDS if clutter is None else 1
    for _ in range(rounds * settings.local_clutter):
        counts = counted(log_odds) if clutter is None else clutter
        log_odds = base - np.bincount(g, np.log(clutter_at(at, counts, settings)), len(member))
    return Existence(log_odds, probability, counted(log_odds))


def log_odds_without_clutter(
    gain: np.ndarray,
    member: np.ndarray,
    probability: np.ndarray,
    usual: Float[np.ndarray, " cam"],
    settings: EvidenceSettings,
) -> Float[np.ndarray, " group"]:
    """Log-odds of groups (H,), assuming that clutter is as frequent as boxes of people.

    Where detections are improbable, boxes of people are rare, so a detection counts relative to the
    other people whom the camera detects.

    Args:
        gain: (H,) log evidence for one person, with appearance.
        member: (H, C) boxes, -1 for none.
        probability: (H, C) of detection, 0 in cameras without a picture.
        usual: (C,) mean of it over the people whom each camera detects.
        settings: constants.
    """
    if settings.use_misses:
        gain = gain + misses(np.where(member < 0, probability, 0.0))
    # A detected person was visible, whatever was expected.
    rate = np.maximum(probability, settings.detection_rate_range[0])
    return gain + np.where(member >= 0, np.log(rate / usual), 0.0).sum(1)


def clutter_at(
    cell: Int[np.ndarray, " n"],
    counts: Float[np.ndarray, "2 cam cells cells"],
    settings: EvidenceSettings,
) -> Float[np.ndarray, " n"]:
    """Ratio of clutter to people around cells, shrunk toward that of the whole camera."""
    person, other = counts.sum((2, 3))
    ratio = (other + 1) / (person + 1)
    c, i, j = np.unravel_index(cell, counts.shape[1:])
    around = np.pad(counts, ((0, 0), (0, 0), (1, 1), (1, 1)))
    near = np.zeros((2, len(cell)))
    for down, aside in np.ndindex(3, 3):
        near += around[:, c, i + down, j + aside]
    pseudo = settings.clutter_pseudo_counts
    smooth = (near[1] + pseudo * ratio[c]) / (near[0] + pseudo)
    return np.clip(smooth, *settings.clutter_range)
