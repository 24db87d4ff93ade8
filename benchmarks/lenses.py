"""Compare 180-degree fisheyes with pinholes in the same places: `python -m benchmarks.lenses`.

The world is a simulated shop with four cameras in its ceiling corners. The same people are seen by
pinholes, by fisheyes, and by fisheyes that the rig takes for pinholes. With a folder of data, its
boxes are used instead, as they are and as lenses with radial distortion k1 show them.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import catfree as cf
from benchmarks.methods import sequences
from benchmarks.paper.scoring import score
from benchmarks.robustness import distorted
from catfree.evaluation import align_centres, crop, detection_metrics
from catfree.synthetic import World, make_world, shop

BENT = (-0.1, -0.3)
METHODS = {"evidence": cf.Settings(), "paper": cf.Settings.paper()}


def moda(world: World, scene: cf.Scene, settings: cf.Settings, frames: int) -> tuple[float, float]:
    """Compute MODA at 0.5 m in the shop, and the median sigma in units of the report's radius."""
    found = cf.localize(world.detections, scene, settings)
    alignment = align_centres(np.asarray(scene.rig.centers), world.true_centres)
    position = np.asarray(alignment(found.tracks.position))
    rows = crop(found.tracks.to_rows(position[:, :2]), world.area)
    truth = crop(world.ground_truth, world.area)
    score = detection_metrics(truth, rows, frames=np.arange(frames)).moda
    return score, found.reliability.sigma_over_radius


def print_bent(data: Path) -> None:
    """Print one row per sequence of real boxes seen without distortion."""
    shown = " | ".join(f"k1 = {k1}" for k1 in BENT)
    print(f"| sequence | as it is | {shown} |\n|---|---|{'---|' * len(BENT)}")
    for sequence in sequences(data):
        lens = sequence.scene.rig.distortion
        if sequence.world is not None or (lens is not None and np.any(lens)):
            continue
        bent = [distorted(sequence, k1, known=True) for k1 in BENT]
        scores = [
            score(cf.localize(one.detections, one.scene), one).moda for one in (sequence, *bent)
        ]
        print(f"| {sequence.name} | {' | '.join(f'{moda:.1f}' for moda in scores)} |", flush=True)


def main() -> None:
    """Print one row per world and method."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("data", type=Path, nargs="?", help="folder of boxes to bend")
    options = parser.parse_args()
    if options.data is not None:
        print_bent(options.data)
        return
    print("| method | seed | pinholes | fisheyes | fisheyes taken for pinholes |")
    print("|---|---|---|---|---|")
    for name, settings in METHODS.items():
        rows = []
        for seed in range(options.seeds):
            scores = []
            for fisheye in (False, True):
                layout = shop(seed, fisheye=fisheye)
                world = make_world(layout, seed, frames=options.frames, background=0)
                scores.append(moda(world, world.scene, settings, options.frames)[0])
            rig = replace(world.scene.rig, lens=None, distortion=None)
            wrong = cf.Scene(rig, world.scene.ground, world.scene.extent)
            mistaken, sigma = moda(world, wrong, settings, options.frames)
            rows.append([*scores, mistaken])
            shown = " | ".join(f"{value:.1f}" for value in rows[-1])
            print(f"| {name} | {seed} | {shown} (sigma / radius {sigma:.2f}) |", flush=True)
        shown = " | ".join(f"{value:.1f}" for value in np.mean(rows, axis=0))
        print(f"| {name} | mean | {shown} |", flush=True)


if __name__ == "__main__":
    main()
