"""Calibrate cameras from people alone, then localize the people with that rig.

Read a sequence in the uniform JSON format with known calibration and positions, calibrate from the
person boxes alone, and compare camera centers and focal lengths with the true rig. Also compare the
detection score (MODA) of the true rig with that of the estimated rig after a similarity alignment,
and after a rigid alignment, which keeps its scale.

    python examples/calibrate_from_people.py sequence.json
"""

import argparse
from pathlib import Path

import numpy as np

import catfree as cf
from catfree.evaluation import align_centres, crop, detection_metrics


def main() -> None:
    """Calibrate, localize and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequence", type=Path, help="uniform JSON with boxes, truth, calibration")
    sequence = cf.adapters.read_uniform_json(parser.parse_args().sequence)
    truth, detections = sequence.scene, sequence.detections

    calibration = cf.calibrate(detections, truth.rig.image_size, camera_names=sequence.camera_names)
    registered = calibration.scene.rig.registered
    centers, true_centers = np.asarray(calibration.scene.rig.centers), np.asarray(truth.rig.centers)
    similarity = align_centres(centers, true_centers, registered=registered)
    rigid = align_centres(centers, true_centers, registered=registered, fixed_scale=True)
    for index, name in enumerate(sequence.camera_names):
        if not registered[index]:
            print(f"{name}: not registered, no evidence")
            continue
        moved = np.asarray(similarity(centers[index]))
        focal = calibration.scene.rig.K[index, 0, 0]
        print(
            f"{name}: center off by {np.linalg.norm(moved - true_centers[index]):.2f} m, focal "
            f"{focal:.0f} px (true {truth.rig.K[index, 0, 0]:.0f}), evidence "
            f"{calibration.log_likelihood_ratio[index]:.0f} above chance"
        )
    print(
        f"scale of the estimated rig: {1 / float(similarity.scale):.3f} of the true one, stated "
        f"deviation {100 * calibration.scale_sd:.0f} %"
    )

    def moda(scene, transform=None):
        tracks = cf.localize(detections, scene).tracks
        xy = np.asarray(tracks.ground_xy)
        if transform is not None:
            xy = np.asarray(transform(np.asarray(tracks.position)))[:, :2]
        positions, people = tracks.to_rows(xy), sequence.ground_truth
        if sequence.evaluation_area is not None:
            area = sequence.evaluation_area
            positions, people = crop(positions, area), crop(people, area)
        return detection_metrics(people, positions, sequence.frames).moda

    print(f"MODA with the true rig:                  {moda(truth):.1f}")
    print(f"MODA with the estimated rig, similarity: {moda(calibration.scene, similarity):.1f}")
    print(f"MODA with the estimated rig, rigid:      {moda(calibration.scene, rigid):.1f}")


if __name__ == "__main__":
    main()
