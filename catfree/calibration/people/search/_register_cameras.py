"""Register all cameras: pairs, seeds, growth, focal lengths, and removal of wrong cameras."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import combinations

import numpy as np

from catfree.calibration.people.adjustment._alternate import AdjustedRig, alternate
from catfree.calibration.people.adjustment._people_bundle import saves
from catfree.calibration.people.cameras._camera_model import LOG_FOCAL
from catfree.calibration.people.cameras._ground_map import RANGE_ERRORS
from catfree.calibration.people.matching._verdict import judge_camera
from catfree.calibration.people.matching._workspace import Workspace
from catfree.calibration.people.search._growth import drop_harmful, grow_rig, prune_rig
from catfree.calibration.people.search._seed_pairs import PairHypothesis, search_pair
from catfree.errors import CalibrationError
from catfree.types._annotations import Progress
from catfree.types._processes import processor_count

FINAL_PEOPLE = 4000
FINAL_ITERATIONS = 15
GOOD_SEED = (0.6, 30)  # minimum association and matches to compare the focal lengths of a pair


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
    grown = _grow_seeds(work, seeds, pairs, report)
    pruned = prune_rig(work, _choose_focal(work, grown))
    registered = drop_harmful(work, pruned)
    if registered.quality[0] != pruned.quality[0]:
        registered = prune_rig(work, _choose_focal(work, registered))
    return registered


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
    return pairs, sorted(seeds, key=lambda seed: -seed.evidence)


def _adjusted(work: Workspace, pair: PairHypothesis) -> AdjustedRig | None:
    """Adjust a pair; None if its cameras do not see the same people."""
    try:
        seed = alternate(work.grid, pair.state, work.settings, tolerances=RANGE_ERRORS[:3])
    except CalibrationError:
        return None
    _, camera = pair.cameras
    verdict = judge_camera(work, seed.state, camera)
    return replace(seed, verdicts={camera: verdict}) if verdict.accepted else None


def _focal_seems_shared(work: Workspace, seeds: list[AdjustedRig]) -> bool:
    """Return whether the separately fitted focal lengths of good pairs mostly agree."""
    association, matches = GOOD_SEED
    ratios = [
        abs(float(np.diff(seed.state.parameters[seed.state.placed, LOG_FOCAL])[0]))
        for seed in seeds
        for verdict in seed.verdicts.values()
        if verdict.judgment.association > association and verdict.judgment.matches > matches
    ]
    return bool(ratios) and float(np.median(ratios)) < work.settings.shared_focal_spread


def _grow_seeds(
    work: Workspace,
    seeds: list[AdjustedRig],
    pairs: list[PairHypothesis],
    report: Progress,
) -> AdjustedRig:
    """Grow seeds until one places every camera; return the rig with most cameras and evidence."""
    useful, shared_focal = work.useful.sum(), _focal_seems_shared(work, seeds)
    grown: list[AdjustedRig] = []
    for done, seed in enumerate(seeds):
        report("growth", done, len(seeds))
        state = replace(seed.state, shared_focal=shared_focal)
        grown.append(grow_rig(work, replace(seed, state=state), pairs))
        if grown[-1].quality[0] >= useful:
            break
    report("growth", len(seeds), len(seeds))
    return max(grown, key=lambda rig: rig.quality)


def _choose_focal(work: Workspace, rig: AdjustedRig) -> AdjustedRig:
    """Adjust with shared and with separate focal lengths and choose between them."""
    shared, separate = (
        alternate(
            work.grid,
            replace(rig.state, shared_focal=is_shared),
            work.settings,
            tolerances=RANGE_ERRORS[2:],
            most_people=FINAL_PEOPLE,
            iterations=FINAL_ITERATIONS,
        )
        for is_shared in (True, False)
    )
    pays = saves(shared.bundle, separate.bundle, work.settings.free_focal_gain)
    return separate if pays else shared
