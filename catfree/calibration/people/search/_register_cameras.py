"""Register all cameras: pairs, seeds, growth, and removal of wrong cameras."""

from concurrent.futures import Future, ThreadPoolExecutor
from itertools import combinations

from catfree.calibration.people.adjustment._alternate import AdjustedRig, alternate
from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search._growth import drop_harmful, grow_rig, prune_rig
from catfree.calibration.people.search._seed_pairs import PairHypothesis, search_pair
from catfree.errors import CalibrationError
from catfree.types._annotations import Progress
from catfree.types._processes import processor_count


def register_cameras(work: Workspace, report: Progress) -> AdjustedRig:
    """Place as many cameras as the boxes support.

    Args:
        work: the sequence.
        report: called as `report(stage, done, total)`.

    Raises:
        CalibrationError: if no two cameras share people.
    """
    pairs, seeds = _search_seeds(work, report)
    if not seeds:
        raise CalibrationError(
            "No two cameras see the same people: of "
            f"{work.grid.camera_count * (work.grid.camera_count - 1) // 2} pairs, none matches at "
            "the true time better than at shifted times; check that the cameras are synchronized, "
            "that their views overlap, that several people walk through the overlap, and that each "
            "has one box per camera (non-maximum suppression)."
        )
    return drop_harmful(work, _grow_seeds(work, seeds, pairs, report))


def _search_seeds(
    work: Workspace, report: Progress
) -> tuple[list[PairHypothesis], list[AdjustedRig]]:
    """Find the best hypothesis of every pair of cameras, and adjust the best pairs.

    Returns:
        All pairs, and those adjusted pairs whose cameras see the same people, each sorted by
        decreasing margin.
    """
    couples = list(combinations(range(work.grid.camera_count), 2))
    pairs: list[PairHypothesis] = []
    adjusting: dict[tuple[int, int], Future[AdjustedRig | None]] = {}
    # One thread compiles or solves while another prepares.
    with ThreadPoolExecutor(processor_count()) as pool:
        for done, couple in enumerate(couples, start=1):
            pair = search_pair(work, *couple)
            if pair is not None:
                pairs.append(pair)
                # The first pair that shares people compiles the solver while others are searched.
                if not adjusting and pair.margin > 0:
                    adjusting[couple] = pool.submit(_adjusted, work, pair)
            report("pairs", done, len(couples))
        pairs.sort(key=lambda pair: -pair.margin)
        chosen = pairs[: work.settings.seed_pairs]
        report("seeds", 0, len(chosen))
        for pair in chosen:
            if pair.cameras not in adjusting:
                adjusting[pair.cameras] = pool.submit(_adjusted, work, pair)
        seeds = []
        for done, pair in enumerate(chosen, start=1):
            seed = adjusting[pair.cameras].result()
            report("seeds", done, len(chosen))
            if seed is not None:
                seeds.append(seed)
    return pairs, sorted(seeds, key=lambda seed: seed.quality, reverse=True)


def _adjusted(work: Workspace, pair: PairHypothesis) -> AdjustedRig | None:
    """Adjust a pair; None if its cameras do not see the same people."""
    try:
        seed = prune_rig(work, alternate(work.grid, pair.state, work.settings))
    except CalibrationError:
        return None
    return seed if seed.quality[0] else None


def _grow_seeds(
    work: Workspace,
    seeds: list[AdjustedRig],
    pairs: list[PairHypothesis],
    report: Progress,
) -> AdjustedRig:
    """Grow seeds until one places every camera; return the rig with most cameras and evidence."""
    useful = work.useful.sum()
    grown: list[AdjustedRig] = []
    for done, seed in enumerate(seeds):
        report("growth", done, len(seeds))
        grown.append(grow_rig(work, seed, pairs))
        if grown[-1].quality[0] >= useful:
            break
    report("growth", len(seeds), len(seeds))
    return max(grown, key=lambda rig: rig.quality)
