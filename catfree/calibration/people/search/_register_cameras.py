"""Registration of all cameras: pairs, growth, and removal of wrong cameras."""

from itertools import combinations

from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search._camera_pairs import PairHypothesis, search_pair
from catfree.calibration.people.search._growth import AdjustedRig, drop_harmful, fit_rig, grow_rig
from catfree.errors import CalibrationError
from catfree.types._annotations import Progress


def register_cameras(work: Workspace, report: Progress) -> AdjustedRig:
    """Place as many cameras as the boxes support.

    Args:
        work: the sequence.
        report: called as `report(stage, done, total)`.

    Raises:
        CalibrationError: if no two cameras share people.
    """
    pairs = _search_pairs(work, report)
    grown = _grow_pairs(work, pairs, report)
    if grown is None:
        raise CalibrationError(
            "No two cameras see the same people: of "
            f"{work.grid.camera_count * (work.grid.camera_count - 1) // 2} pairs, none matches at "
            "the true time better than at shifted times; check that the cameras are synchronized, "
            "that their views overlap, that several people walk through the overlap, and that each "
            "has one box per camera (non-maximum suppression)."
        )
    return drop_harmful(work, grown)


def _search_pairs(work: Workspace, report: Progress) -> list[PairHypothesis]:
    """Find the pairs of cameras that see the same people, by decreasing margin."""
    couples = list(combinations(range(work.grid.camera_count), 2))
    found = []
    for done, couple in enumerate(couples, start=1):
        pair = search_pair(work, *couple)
        if pair is not None and pair.margin > 0:
            found.append(pair)
        report("pairs", done, len(couples))
    return sorted(found, key=lambda pair: -pair.margin)


def _grow_pairs(
    work: Workspace, pairs: list[PairHypothesis], report: Progress
) -> AdjustedRig | None:
    """Grow every pair that no earlier, better pair grew to include.

    Returns:
        The rig with the most cameras and evidence; None if there is no pair.
    """
    grown: list[AdjustedRig] = []
    for done, pair in enumerate(pairs):
        report("growth", done, len(pairs))
        if any(rig.state.placed[pair.state.placed].all() for rig in grown):
            continue
        rig = fit_rig(work, pair.state)
        if rig is not None and rig.quality[0]:
            grown.append(grow_rig(work, rig))
    report("growth", len(pairs), len(pairs))
    return max(grown, key=lambda rig: rig.quality, default=None)
