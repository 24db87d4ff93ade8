"""A metric camera rig and its ground plane from person boxes alone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from catfree.errors import CalibrationError, InvalidInputError
from catfree.rig.pedestrians.adjustment import AdjustedRig, alternate
from catfree.rig.pedestrians.camera_model import LOG_FOCAL, X, to_matrices
from catfree.rig.pedestrians.constants import CalibrationSettings
from catfree.rig.pedestrians.growth import (
    PairHypothesis,
    Verdict,
    Workspace,
    drop_harmful,
    grow_rig,
    judge_camera,
    prune_rig,
    search_pair,
    seed_rig,
)
from catfree.rig.pedestrians.observations import grid_boxes
from catfree.types import Detections, Plane, Rig, Scene

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Calibration:
    """A rig found from pedestrians alone.

    Attributes:
        scene: metric scene, z up, ground z = 0; cameras that cannot be trusted are not registered
            and hold NaN.
        association_rate: (C,) share of the people whom a camera and the rest of the rig should both
            see that they agree on; NaN where not registered.
        log_likelihood_ratio: (C,) evidence of each camera against the map of the others, NaN where
            there is none.
        focal_sd: (C,) standard deviation of the focal length in pixels.
        center_covariance: (C, 3, 3) of the camera centres in square metres.
        shared_focal: whether the cameras were found to have one focal length.
        foot_offset: metres by which the bottom of a box is nearer than the body axis.
        residual: median absolute residual in standard deviations of the box edges.
        frame_offset: (C,) frames by which each camera's clock was found to be late.
    """

    scene: Scene
    association_rate: np.ndarray
    log_likelihood_ratio: np.ndarray
    focal_sd: np.ndarray
    center_covariance: np.ndarray
    shared_focal: bool
    foot_offset: float
    residual: float
    frame_offset: np.ndarray


def calibrate(
    detections: Detections,
    image_size: Any,
    settings: CalibrationSettings | None = None,
    *,
    camera_names: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Find cameras and ground in metres from nothing but boxes of walking people."""
    settings = CalibrationSettings() if settings is None else settings
    size = _sizes(detections, image_size)
    names = [str(c) for c in range(len(size))] if camera_names is None else list(camera_names)
    report = progress or (lambda stage, done, total: None)
    grid = grid_boxes(detections, size, settings)
    work = Workspace(grid, settings)
    pairs = _search_pairs(work, report)
    rig, verdicts, shared = _best_rig(work, pairs, report)
    return _result(work, rig, verdicts, shared, names)


def _sizes(detections: Detections, image_size: Any) -> np.ndarray:
    size = np.asarray(image_size, np.int64)
    if size.shape == (2,):
        count = int(detections.camera.max(initial=-1)) + 1
        size = np.tile(size, (max(count, 1), 1))
    return size


def _search_pairs(work: Workspace, report: Progress) -> list[PairHypothesis]:
    """The best hypothesis of every pair of cameras, most convincing first."""
    couples = list(combinations(range(work.grid.camera_count), 2))
    found = []
    for done, (one, two) in enumerate(couples):
        pair = search_pair(work, one, two)
        if pair is not None:
            found.append(pair)
        report("pairs", done + 1, len(couples))
    return sorted(found, key=lambda pair: -pair.margin)


def _best_rig(work: Workspace, pairs: list[PairHypothesis], report: Progress):
    settings = work.settings
    seeds = []
    for done, pair in enumerate(pairs[: settings.seed_pairs]):
        seed = seed_rig(work, pair)
        verdict = judge_camera(work, seed.state, pair.cameras[1])
        seeds.append((verdict, seed, pair.cameras))
        report("seeds", done + 1, min(len(pairs), settings.seed_pairs))
    seeds.sort(key=lambda item: -item[0].margin)
    ratios = [
        abs(float(np.diff(seed.state.parameters[list(cameras), LOG_FOCAL])[0]))
        for verdict, seed, cameras in seeds
        if verdict.judgement.association > 0.6 and verdict.judgement.matches > 30
    ]
    shared = bool(ratios) and float(np.median(ratios)) < settings.shared_focal_spread
    best = None
    for done, (_, seed, _) in enumerate(seeds[:2]):
        rig, verdicts = grow_rig(work, seed, pairs, shared_focal=shared)
        quality = (
            int(rig.state.placed.sum()),
            sum(v.margin for v in verdicts.values()),
        )
        report("growth", done + 1, 2)
        if best is None or quality > best[0]:
            best = quality, rig
    if best is None:
        raise CalibrationError("nothing")
    rig, shared = _choose_focal(work, best[1])
    rig, verdicts = prune_rig(work, rig, shared_focal=shared)
    kept = rig.state.placed.sum()
    rig, verdicts = drop_harmful(work, rig, verdicts, shared_focal=shared)
    if rig.state.placed.sum() < kept:
        rig, shared = _choose_focal(work, rig)
        rig, verdicts = prune_rig(work, rig, shared_focal=shared)
    return rig, verdicts, shared


def _choose_focal(work: Workspace, rig: AdjustedRig) -> tuple[AdjustedRig, bool]:
    """Final adjustment with one focal length and with one each; free ones must earn their keep."""
    settings = work.settings
    together, apart = (
        alternate(
            work.grid,
            rig.state,
            settings,
            shared_focal=shared,
            tolerances=FINAL_TOLERANCES,
            most_people=FINAL_PEOPLE,
            iterations=15,
        )
        for shared in (True, False)
    )
    costs = [r.bundle.cost / len(r.bundle.xy) for r in (together, apart)]
    shared = costs[1] > (1 - settings.free_focal_gain) * costs[0]
    return (together if shared else apart), shared


FINAL_TOLERANCES = (0.03, 0.02, 0.01)
FINAL_PEOPLE = 4000


def _result(work, rig: AdjustedRig, verdicts: dict[int, Verdict], shared, names) -> Calibration:
    count = work.grid.camera_count
    state = rig.state
    trusted = np.zeros(count, bool)
    association, evidence = np.full(count, np.nan), np.full(count, np.nan)
    for camera, verdict in verdicts.items():
        trusted[camera] = verdict.accepted
        association[camera] = verdict.judgement.association
        evidence[camera] = verdict.judgement.evidence
    if trusted.sum() < 2:
        raise CalibrationError("fewer than two")
    parameters = np.where(trusted[:, None], state.parameters, np.nan)
    K, R, t = to_matrices(parameters, work.grid.size)
    K[~trusted] = np.nan
    rig_out = Rig(K, R, t, work.grid.size, registered=trusted)
    ground = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    covariance = rig.bundle.covariance
    index = 7 * np.arange(count)[:, None] + np.arange(X, X + 3)
    center = covariance[index[:, :, None], index[:, None, :]]
    focal_sd = np.exp(parameters[:, LOG_FOCAL]) * np.sqrt(
        np.diag(covariance)[7 * np.arange(count) + LOG_FOCAL]
    )
    return Calibration(
        Scene.from_rig(rig_out, ground, metric=True),
        association,
        evidence,
        focal_sd,
        np.where(trusted[:, None, None], center, np.nan),
        shared,
        state.foot_offset,
        rig.bundle.residual,
        np.zeros(count, int),
    )
