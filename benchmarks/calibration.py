"""Measure the accuracy of rigs recovered from simulated pedestrians alone.

The worlds vary the number and layout of cameras, the length, and the noise of the boxes; some boxes
are truncated and a tenth are false. The crowd of each world is a few percent taller or shorter than
the 1.70 m that the calibration assumes, which boxes cannot reveal: the scale error is printed as
measured, and as it would be with the true mean height of the crowd. `--registration` skips the
evidence loop; `--quick` uses every fourth world.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from catfree.calibration import calibrate
from catfree.errors import CalibrationError
from catfree.geometry import fit_similarity
from catfree.settings import CalibrationSettings
from catfree.synthetic import DetectorModel, make_world


@dataclass(frozen=True)
class Case:
    """One simulated world: layout, length, and box noise in pixels."""

    layout: str
    frames: int
    pixel_noise: float
    seed: int


@dataclass(frozen=True)
class Outcome:
    """Result for one world.

    Attributes:
        registered, cameras: numbers of registered and of all cameras.
        center_error: mean center error after a similarity, in meters.
        focal_error: mean relative error of the focal lengths.
        scale_error: relative error of the scale.
        scale_error_known_height: remaining error if the crowd's mean height is known.
        scale_sd: stated standard deviation of the scale.
        seconds: wall time.
    """

    registered: int
    cameras: int
    center_error: float = np.nan
    focal_error: float = np.nan
    scale_error: float = np.nan
    scale_error_known_height: float = np.nan
    scale_sd: float = np.nan
    seconds: float = np.nan


CASES = [
    Case(layout, frames, noise, seed)
    for seed, (layout, frames, noise) in enumerate(
        [
            *[(f"ring{c}", 100, 5.0) for c in (5, 6, 7, 8)],
            *[("ring7", 100, noise) for noise in (2.0, 5.0, 10.0)],
            *[("ring6", frames, 5.0) for frames in (40, 200, 400)],
            *[("wildtrack", frames, 2.0) for frames in (60, 100, 200)],
            *[("multiviewx", frames, 5.0) for frames in (40, 80)],
            *[("gmvd6", 80, noise) for noise in (2.0, 5.0)],
            *[("gmvd8", frames, 2.0) for frames in (40, 80)],
            *[("ring5", 60, noise) for noise in (2.0, 10.0)],
            *[("ring8", 40, 5.0)],
        ]
    )
]


def run_case(case: Case, settings: CalibrationSettings) -> Outcome:
    """Simulate, calibrate and compare."""
    detector = DetectorModel(pixel_noise=case.pixel_noise, embedding_size=0, false_positives=1.2)
    world = make_world(case.layout, case.seed, frames=case.frames, detector=detector)
    truth = world.true_rig
    start = time.perf_counter()
    try:
        found = calibrate(world.detections, truth.image_size, settings)
    except CalibrationError:
        return Outcome(0, truth.camera_count)
    seconds = time.perf_counter() - start
    rig = found.scene.rig
    known = rig.registered
    if known.sum() < 3:
        return Outcome(int(known.sum()), truth.camera_count, seconds=seconds)
    centers, true_centers = np.asarray(rig.centers)[known], np.asarray(truth.centers)[known]
    similarity = fit_similarity(centers, true_centers)
    error = np.linalg.norm(np.asarray(similarity(centers)) - true_centers, axis=-1)
    scale = 1 / float(similarity.scale)
    people = world.identities[world.identities >= 0]
    shown = float(world.walkers.height[people].mean())
    focal = np.asarray(rig.K)[known, 0, 0] / np.asarray(truth.K)[known, 0, 0]
    return Outcome(
        int(known.sum()),
        truth.camera_count,
        float(error.mean()),
        float(np.abs(focal - 1).mean()),
        scale - 1,
        scale * shown / settings.person_height - 1,
        found.scale_sd,
        seconds,
    )


@dataclass(frozen=True)
class Summary:
    """Result for all worlds together.

    Attributes:
        complete: percent of the worlds in which every camera was registered.
        center_error, center_error_p90: median and 90th percentile in meters.
        focal_error: median in percent.
        scale_error, scale_error_worst: median and largest in percent.
        scale_error_known_height: median in percent.
        covered: percent of the worlds whose scale lies within two stated deviations.
    """

    complete: float
    center_error: float
    center_error_p90: float
    focal_error: float
    scale_error: float
    scale_error_worst: float
    scale_error_known_height: float
    covered: float


def summarize(outcomes: Sequence[Outcome]) -> Summary:
    """Compute quantiles; worlds without a rig count only as incomplete and not covered."""
    center = [o.center_error for o in outcomes]
    scale = np.abs([o.scale_error for o in outcomes])
    known = np.abs([o.scale_error_known_height for o in outcomes])
    return Summary(
        100 * float(np.mean([o.registered == o.cameras for o in outcomes])),
        float(np.nanmedian(center)),
        float(np.nanquantile(center, 0.9)),
        100 * float(np.nanmedian([o.focal_error for o in outcomes])),
        100 * float(np.nanmedian(scale)),
        100 * float(np.nanmax(scale)),
        100 * float(np.nanmedian(known)),
        100 * float(np.mean(scale <= 2 * np.array([o.scale_sd for o in outcomes]))),
    )


def main() -> None:
    """Print one line per world and the summary."""
    cases = CASES[::4] if "--quick" in sys.argv else CASES
    rounds = 0 if "--registration" in sys.argv else CalibrationSettings().evidence_rounds
    settings = CalibrationSettings(evidence_rounds=rounds)
    print(
        f"{'world':12} frames  px  cameras  centre m  focal %  scale %"
        "  height known %   sd %  seconds"
    )
    outcomes = []
    for case in cases:
        o = run_case(case, settings)
        outcomes.append(o)
        world = f"{case.layout:12} {case.frames:6d} {case.pixel_noise:3.0f}"
        errors = f"{o.center_error:8.3f} {100 * o.focal_error:8.1f} {100 * o.scale_error:+8.1f}"
        errors += f" {100 * o.scale_error_known_height:+15.1f} {100 * o.scale_sd:6.1f}"
        print(f"{world} {o.registered:4d}/{o.cameras}    {errors} {o.seconds:8.1f}", flush=True)
    summary = summarize(outcomes)
    print(
        f"complete {summary.complete:.0f} %, centre error median {summary.center_error:.3f} m, "
        f"p90 {summary.center_error_p90:.3f} m, focal {summary.focal_error:.1f} %, "
        f"scale {summary.scale_error:.1f} % ({summary.scale_error_known_height:.1f} % if the "
        f"crowd's height were known; at most {summary.scale_error_worst:.1f} %; within two "
        f"standard deviations in {summary.covered:.0f} % of the worlds)"
    )


if __name__ == "__main__":
    main()
