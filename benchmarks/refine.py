"""What refining a disturbed rig with people gains: `python benchmarks/refine.py [--quick]`.

Every camera is off by 1 degree, 0.3 m and 2 % of its focal length, the ground by half a degree and
5 cm. Camera centres are compared after the similarity that fits them best.
"""

import argparse
import time

import numpy as np

import catfree as cf
from catfree.evaluation import align_centres, detection_metrics
from catfree.rig import refine
from catfree.synthetic import RigError, World, make_world

LAYOUTS = ("wildtrack", "multiviewx", "gmvd6", "gmvd8", "ring4", "ring5", "ring6", "ring8")


def center_error(scene: cf.Scene, world: World) -> float:
    """Mean distance of the camera centres from the true ones in metres."""
    centers = np.asarray(scene.rig.centers)
    moved = np.asarray(align_centres(centers, world.true_centres)(centers))
    return float(np.linalg.norm(moved - world.true_centres, axis=-1).mean())


def focal_error(scene: cf.Scene, world: World) -> float:
    """Mean relative error of the focal lengths."""
    ratio = np.asarray(scene.rig.K)[:, 0, 0] / np.asarray(world.true_rig.K)[:, 0, 0]
    return float(np.abs(ratio - 1).mean())


def moda(scene: cf.Scene, world: World) -> float:
    """MODA in percent of the paper's method."""
    tracks = cf.localize(world.detections, scene, cf.Settings.paper()).tracks
    to_world = align_centres(np.asarray(scene.rig.centers), world.true_centres)
    xy = np.asarray(to_world(np.asarray(tracks.position)))[:, :2]
    x_min, x_max, y_min, y_max = world.area
    inside = ((xy >= [x_min, y_min]) & (xy <= [x_max, y_max])).all(axis=1)
    rows = np.column_stack([tracks.frame, tracks.track_id, xy])[inside]
    return float(detection_metrics(world.ground_truth, rows).moda)


def main() -> None:
    """Print one line a world."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--quick", action="store_true", help="one seed, 40 frames, 5 rounds")
    options = parser.parse_args()
    if options.quick:
        options.frames, options.seeds, options.rounds = 40, 1, 5
    print(
        "world       seed   centre m      focal %      MODA          round  residual mrad  seconds"
    )
    ratios = []
    for layout in LAYOUTS:
        for seed in range(options.seeds):
            error = RigError(1.0, 0.3, 0.02, 0.5, 0.05)
            world = make_world(layout, seed, frames=options.frames, rig_error=error)
            start = time.perf_counter()
            found = refine(world.detections, world.scene, rounds=options.rounds)
            seconds = time.perf_counter() - start
            scenes = (world.scene, found.scene)
            center = [center_error(scene, world) for scene in scenes]
            focal = [100 * focal_error(scene, world) for scene in scenes]
            score = [moda(scene, world) for scene in scenes]
            ratios.append(center[1] / center[0])
            residual = 1e3 * found.residuals[[0, found.chosen]]
            print(
                f"{layout:11} {seed:3d}  {center[0]:.3f} {center[1]:.3f}  "
                f"{focal[0]:5.2f} {focal[1]:5.2f}  {score[0]:5.1f} {score[1]:5.1f}  "
                f"{found.chosen:4d}  {residual[0]:6.2f} {residual[1]:6.2f}  {seconds:6.1f}",
                flush=True,
            )
    ratio = np.array(ratios)
    print(
        f"centre error after / before: median {np.median(ratio):.2f}, worst {ratio.max():.2f}, "
        f"halved in {100 * np.mean(ratio <= 0.5):.0f} % of the worlds"
    )


if __name__ == "__main__":
    main()
