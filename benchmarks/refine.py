"""Measure the gain from refining a disturbed rig: `python benchmarks/refine.py [--quick]`.

Every camera is off by 1 degree, 0.3 m and 2 % of its focal length, and the ground by half a degree
and 5 cm. Camera centers are compared after the best-fitting similarity. Both methods refine the
same rig: "paper" with all rounds of the paper's procedure, "evidence" until the residual stops
falling. MODA is that of the paper's method with each rig.
"""

import argparse
import time

import numpy as np
from jaxtyping import Float

import catfree as cf
from catfree.calibration import refine
from catfree.evaluation import align_centres, detection_metrics
from catfree.synthetic import RigError, World, make_world

LAYOUTS = ("wildtrack", "multiviewx", "gmvd6", "gmvd8", "ring4", "ring5", "ring6", "ring8")
METHODS = {"paper": cf.Settings.paper(), "evidence": cf.Settings()}


def center_error(scene: cf.Scene, true_centers: Float[np.ndarray, "cam 3"]) -> float:
    """Compute the mean distance in meters of camera centers from the truth, after a similarity."""
    centers = np.asarray(scene.rig.centers)
    moved = np.asarray(align_centres(centers, true_centers)(centers))
    return float(np.linalg.norm(moved - true_centers, axis=-1).mean())


def focal_error(scene: cf.Scene, world: World) -> float:
    """Compute the mean relative error of the focal lengths."""
    ratio = np.asarray(scene.rig.K)[:, 0, 0] / np.asarray(world.true_rig.K)[:, 0, 0]
    return float(np.abs(ratio - 1).mean())


def moda(scene: cf.Scene, world: World) -> float:
    """Compute the MODA of the paper's method in percent."""
    tracks = cf.localize(world.detections, scene, cf.Settings.paper()).tracks
    to_world = align_centres(np.asarray(scene.rig.centers), world.true_centres)
    xy = np.asarray(to_world(np.asarray(tracks.position)))[:, :2]
    x_min, x_max, y_min, y_max = world.area
    inside = ((xy >= [x_min, y_min]) & (xy <= [x_max, y_max])).all(axis=1)
    rows = np.column_stack([tracks.frame, tracks.track_id, xy])[inside]
    return float(detection_metrics(world.ground_truth, rows).moda)


def run(world: World, settings: cf.Settings, rounds: int) -> tuple[cf.Refinement, float]:
    """Refine the rig; return the refinement and its CPU seconds."""
    start = time.process_time()
    found = refine(world.detections, world.scene, settings, rounds=rounds)
    return found, time.process_time() - start


def main() -> None:
    """Print one line per world and method."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--layouts", nargs="*", default=LAYOUTS)
    parser.add_argument("--quick", action="store_true", help="one seed, 40 frames, 5 rounds")
    options = parser.parse_args()
    if options.quick:
        options.frames, options.seeds, options.rounds = 40, 1, 5
    print(
        "world       seed  method     centre m      ratio  focal %      MODA          "
        "round  residual mrad  CPU s"
    )
    ratios: dict[str, list[float]] = {name: [] for name in METHODS}
    for layout in options.layouts:
        for seed in range(options.seeds):
            error = RigError(1.0, 0.3, 0.02, 0.5, 0.05)
            world = make_world(layout, seed, frames=options.frames, rig_error=error)
            before = center_error(world.scene, world.true_centres), focal_error(world.scene, world)
            given = moda(world.scene, world)
            for name, settings in METHODS.items():
                found, seconds = run(world, settings, options.rounds)
                center = center_error(found.scene, world.true_centres)
                ratios[name].append(center / before[0])
                residual = 1e3 * found.residuals[[0, found.chosen]]
                focal = 100 * before[1], 100 * focal_error(found.scene, world)
                print(
                    f"{layout:11} {seed:4d}  {name:8}  {before[0]:.3f} {center:.3f}  "
                    f"{ratios[name][-1]:5.2f}  {focal[0]:5.2f} {focal[1]:5.2f}  "
                    f"{given:5.1f} {moda(found.scene, world):5.1f}  "
                    f"{found.chosen:2d}/{len(found.residuals) - 1:2d}  "
                    f"{residual[0]:6.2f} {residual[1]:6.2f}  {seconds:5.1f}",
                    flush=True,
                )
    for name, values in ratios.items():
        ratio = np.array(values)
        print(
            f"{name}: centre error after / before: median {np.median(ratio):.2f}, worst "
            f"{ratio.max():.2f}, halved in {100 * np.mean(ratio <= 0.5):.0f} % of the worlds"
        )


if __name__ == "__main__":
    main()
