"""Registration of all cameras: pairs, growth, and removal of wrong cameras."""

from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search._camera_pairs import rank_pairs, search_pair
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
    grown = _grow_pairs(work, rank_pairs(work, report), report)
    if grown is None:
        raise CalibrationError(
            "No two cameras see the same people: of "
            f"{work.grid.camera_count * (work.grid.camera_count - 1) // 2} pairs, none matches at "
            "the true time better than at shifted times; check that the cameras are synchronized, "
            "that their views overlap, that several people walk through the overlap, and that each "
            "has one box per camera (non-maximum suppression)."
        )
    return drop_harmful(work, grown)


def _grow_pairs(
    work: Workspace, couples: list[tuple[int, int]], report: Progress
) -> AdjustedRig | None:
    """Grow a rig from every pair of cameras that no earlier pair grew to include.

    Returns:
        The rig with the most cameras and evidence; None if no pair sees the same people.
    """
    grown: list[AdjustedRig] = []
    for done, couple in enumerate(couples):
        report("growth", done, len(couples))
        if any(rig.state.placed[list(couple)].all() for rig in grown):
            continue
        pair = search_pair(work, *couple)
        rig = None if pair is None else fit_rig(work, pair)
        if rig is not None and rig.quality[0]:
            grown.append(grow_rig(work, rig))
    report("growth", len(couples), len(couples))
    return max(grown, key=lambda rig: rig.quality, default=None)
