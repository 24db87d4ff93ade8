r"""Run real videos with and without networks, with a given rig and one from people.

    python examples/real_footage.py a.mp4 b.mp4 c.mp4 --stride 5 \
        --detector yolo11n-pose.onnx --embedder osnet_x0_25_msmt17.onnx --truth campus.json

Without `--detector`, boxes come from the moving foreground and appearance from colors. `--truth` is
a JSON file in the uniform format, with cameras and annotated positions: then every result is
scored, and the given rig is used as well. Without it, three checks need no truth: which cameras are
registered and how high they are mounted, how tall the people are, and how many boxes support a
position. Also look at the pictures and the report in the output folder.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

import catfree as cf
from catfree import RunOutcome, run_stages, write_results
from catfree._run.detection._second_look import track_heights
from catfree.adapters import (
    MultiViewSequence,
    ReIdOnnx,
    SynchronizedVideos,
    YoloPoseOnnx,
    read_uniform_json,
)
from catfree.evaluation import align_centres, detection_metrics, tracking_metrics
from catfree.viz import draw_frame

PICTURES = 4  # instants to draw
GATE = 0.5  # meters from an annotated person


class Score(NamedTuple):
    """Comparison with annotated people, over instants with at least one of them.

    Attributes:
        moda, precision, recall: in percent, at half a meter.
        idf1: in percent, at one meter.
        camera_error: (C,) meters, after the similarity that aligns the centers; NaN for
            unregistered cameras.
        scale: scale of that similarity; 1 with the given rig.
    """

    moda: float
    precision: float
    recall: float
    idf1: float
    camera_error: np.ndarray
    scale: float

    def __str__(self) -> str:
        away = ", ".join(f"{error:.2f}" for error in self.camera_error)
        return (
            f"MODA {self.moda:.1f} (precision {self.precision:.1f}, recall {self.recall:.1f}), "
            f"IDF1 {self.idf1:.1f}; cameras off by {away} m, scale {self.scale:.3f}"
        )


def score(outcome: RunOutcome, truth: MultiViewSequence) -> Score:
    """Compare the positions and the cameras of a run with annotated ones."""
    assert truth.rig is not None
    rig, tracks = outcome.scene.rig, outcome.localization.tracks
    align = align_centres(rig.centers, truth.rig.centers, registered=rig.registered)
    error = np.linalg.norm(np.asarray(align(rig.centers)) - truth.rig.centers, axis=1)
    frames = np.intersect1d(outcome.frames, truth.ground_truth[:, 0]).astype(int)
    people = truth.ground_truth[np.isin(truth.ground_truth[:, 0], frames)]
    rows = tracks.to_rows(np.asarray(align(tracks.position))[:, :2])
    rows = rows[np.isin(rows[:, 0], frames)]
    found = detection_metrics(people, rows, frames, threshold=GATE)
    identities = tracking_metrics(people, rows, frames, threshold=2 * GATE)
    return Score(
        found.moda, found.precision, found.recall, identities.idf1,
        np.where(rig.registered, error, np.nan), float(align.scale),
    )  # fmt: skip


def describe(outcome: RunOutcome, names: list[str]) -> None:
    """Print the plausibility checks of cameras and people."""
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
    height = track_heights(outcome.localization, outcome.detections, outcome.scene)
    tall = [np.median(height[tracks.track_id == one]) for one in people]
    print(f"heights: {np.median(tall):.2f} m, from {min(tall):.2f} to {max(tall):.2f} m")
    print(f"boxes that support a position: {outcome.localization.reliability.detections_used:.0%}")


def draw(outcome: RunOutcome, videos: SynchronizedVideos, out: Path) -> None:
    """Draw boxes, tracks and posts of a person's height in all cameras at a few instants."""
    chosen = np.linspace(0, videos.frame_count - 1, PICTURES + 2).round().astype(int)[1:-1]
    for at, (frame, images) in enumerate(videos):
        if at not in chosen:
            continue
        for camera, image in enumerate(images):
            picture = draw_frame(
                image, camera, frame, outcome.detections, outcome.localization, outcome.scene
            )
            file = out / f"camera_{camera}_frame_{frame}.png"
            cv2.imwrite(str(file), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))


def main() -> None:
    """Run each combination of boxes and rig; score or describe it, and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("videos", nargs="+", help="one video file or image folder per camera")
    parser.add_argument("--detector", help="ONNX file of YOLO11- or YOLOv8-pose")
    parser.add_argument("--embedder", help="ONNX file of a re-identification network")
    parser.add_argument("--truth", type=Path, help="cameras and positions in the uniform format")
    parser.add_argument("--stride", type=int, default=1, help="use every n-th frame")
    parser.add_argument("--end", type=int, help="frame to stop before")
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder for the results")
    options = parser.parse_args()

    videos = SynchronizedVideos(options.videos, stride=options.stride, end=options.end)
    print(f"{videos.camera_count} cameras, {videos.frame_count} instants, {videos.fps or 0:.1f} Hz")
    truth = read_uniform_json(options.truth) if options.truth else None
    stages = {"foreground": (None, None)}
    if options.detector:
        embedder = ReIdOnnx(options.embedder) if options.embedder else None
        stages["networks"] = (YoloPoseOnnx(options.detector), embedder)
    scenes = {"rig from people": None}
    if truth is not None:
        scenes["given rig"] = truth.scene
    for boxes, (detector, embedder) in stages.items():
        for rig, scene in scenes.items():
            out = options.out / f"{boxes}, {rig}".replace(", ", "_").replace(" ", "_")
            try:
                outcome = run_stages(
                    videos, detector, embedder, scene=scene, cache_dir=options.out / "cache"
                )
            except cf.CatFreeError as error:
                print(f"{boxes}, {rig}: no result. {error}")
                continue
            write_results(out, outcome, videos=videos)
            draw(outcome, videos, out)
            if truth is not None:
                print(f"{boxes}, {rig}: {score(outcome, truth)}")
            else:
                print(f"{boxes}, {rig}:")
                describe(outcome, videos.camera_names)


if __name__ == "__main__":
    main()
