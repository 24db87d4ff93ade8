"""Run networks on real videos and check the plausibility of the result without ground truth.

    python examples/real_footage.py a.mp4 b.mp4 c.mp4 --detector yolo11n-pose.onnx --stride 3

Boxes and embeddings come from the networks, cameras and ground from the people. Three checks need
no ground truth: which cameras are registered and how high they are mounted, how tall the people
are, and how well the boxes agree with the tracks. Also look at the pictures in the output folder.

`--reconstructor vggt.onnx` also runs a VGGT export on the first instant and prints the cameras.
`--multiviewx FOLDER` measures the detector's recall of the annotated people of MultiviewX, in whole
images and in tiles.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

import catfree as cf
from catfree import RunOutcome, run_stages, write_results
from catfree._run._second_look import track_heights
from catfree.adapters import (
    ReIdOnnx,
    SynchronizedVideos,
    VggtOnnx,
    YoloPoseOnnx,
    read_multiviewx,
)
from catfree.adapters.detectors._box_suppression import box_overlap
from catfree.viz import draw_frame

PICTURES = 4  # instants that are drawn
MATCH = 0.5  # intersection over union of a correct box


def describe(outcome: RunOutcome, names: list[str]) -> None:
    """Print quantities of cameras and people that can be checked for plausibility."""
    rig, tracks = outcome.scene.rig, outcome.localization.tracks
    for camera, name in enumerate(names):
        boxes = int((outcome.detections.camera == camera).sum())
        if not rig.registered[camera]:
            print(f"{name}: {boxes} boxes, not registered")
            continue
        center, K = np.asarray(rig.centers)[camera], np.asarray(rig.K)[camera]
        axis = np.asarray(rig.R)[camera][2]
        width = rig.image_size[camera, 0]
        print(
            f"{name}: {boxes} boxes, {center[2]:.1f} m high, looks down "
            f"{np.degrees(np.arcsin(-axis[2])):.0f} degrees, "
            f"{np.degrees(2 * np.arctan(width / 2 / K[0, 0])):.0f} degrees wide"
        )
    people = np.unique(tracks.track_id)
    if not len(tracks):
        print("nobody was localized")
        return
    per_frame = np.bincount(np.unique(tracks.frame, return_inverse=True)[1])
    extent = np.ptp(tracks.ground_xy, axis=0)
    print(
        f"{len(people)} tracks, {np.median(per_frame):.0f} people at a time, on {extent[0]:.1f} x "
        f"{extent[1]:.1f} m; sigma {np.median(tracks.sigma):.2f} m"
    )
    steps = [
        np.linalg.norm(np.diff(tracks.ground_xy[tracks.track_id == one], axis=0), axis=-1)
        for one in people
    ]
    print(f"largest step between two instants: {max(map(np.max, filter(len, steps))):.2f} m")
    height = track_heights(outcome.localization, outcome.detections, outcome.scene)
    tall = [np.median(height[tracks.track_id == one]) for one in people]
    print(f"heights: {np.median(tall):.2f} m, from {min(tall):.2f} to {max(tall):.2f} m")
    print(f"boxes that support a position: {outcome.localization.reliability.detections_used:.0%}")


def draw(outcome: RunOutcome, videos: SynchronizedVideos, out: Path) -> list[Path]:
    """Draw boxes, tracks and posts of a person's height at a few instants of all cameras."""
    chosen = np.linspace(0, videos.frame_count - 1, PICTURES + 2).round().astype(int)[1:-1]
    files = []
    for at, (frame, images) in enumerate(videos):
        if at not in chosen:
            continue
        for camera, image in enumerate(images):
            picture = draw_frame(
                image, camera, frame, outcome.detections, outcome.localization, outcome.scene
            )
            files.append(out / f"camera_{camera}_frame_{frame}.png")
            cv2.imwrite(str(files[-1]), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    return files


def reconstruct(path: str, images: list[np.ndarray]) -> None:
    """Print the reconstruction of one instant by a VGGT export."""
    found = VggtOnnx(path)(images)
    focal = ", ".join(f"{value:.0f}" for value in found.K[:, 0, 0])
    print(
        f"reconstruction: {int(found.registered.sum())} of {len(images)} cameras, focal lengths "
        f"{focal} px, {len(found.points)} points"
    )


def measure_recall(detector: str, folder: Path) -> None:
    """Print the share of MultiviewX's annotated people that the detector finds."""
    sequence = read_multiviewx(folder)
    pictures = [
        (camera, int(frame), path)
        for camera, row in enumerate(sequence.images)
        for frame, path in zip(sequence.frames, row, strict=True)
        if path is not None
    ]
    if not pictures:
        print(f"{folder} holds no pictures (Image_subsets/C1..C6), so recall is not measured.")
        return
    truth = sequence.detections
    for tiles in (None, (2, 2), (3, 2)):
        find, hits, total = YoloPoseOnnx(detector, tiles=tiles), 0, 0
        for camera, frame, path in pictures:
            people = truth.box[(truth.camera == camera) & (truth.frame == frame)]
            image = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
            overlap = box_overlap(people.astype(np.float32), find(image).box.astype(np.float32))
            hits += int((overlap.max(axis=1, initial=0) >= MATCH).sum())
            total += len(people)
        print(f"recall of {total} people, tiles {tiles}: {hits / max(total, 1):.1%}")


def main() -> None:
    """Run, describe, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("videos", nargs="+", help="one video file or image folder per camera")
    parser.add_argument("--detector", required=True, help="ONNX file of YOLO11- or YOLOv8-pose")
    parser.add_argument("--embedder", help="ONNX file of a re-identification network")
    parser.add_argument("--reconstructor", help="ONNX file of VGGT")
    parser.add_argument("--multiviewx", type=Path, help="folder of MultiviewX with its pictures")
    parser.add_argument("--stride", type=int, default=1, help="use every n-th frame")
    parser.add_argument("--end", type=int, help="frame to stop before")
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder for the results")
    options = parser.parse_args()

    videos = SynchronizedVideos(options.videos, stride=options.stride, end=options.end)
    print(f"{videos.camera_count} cameras, {videos.frame_count} instants, {videos.fps or 0:.1f} Hz")
    if options.reconstructor:
        reconstruct(options.reconstructor, next(iter(videos))[1])
    if options.multiviewx:
        measure_recall(options.detector, options.multiviewx)
    try:
        outcome = run_stages(
            videos,
            YoloPoseOnnx(options.detector),
            ReIdOnnx(options.embedder) if options.embedder else None,
            cache_dir=options.out / "cache",
        )
    except cf.CatFreeError as error:
        print(f"No result: {error}")
        return
    write_results(options.out, outcome, videos=videos)
    describe(outcome, videos.camera_names)
    for path in draw(outcome, videos, options.out):
        print(path)


if __name__ == "__main__":
    main()
