"""Track people with your own cameras.

    python examples/own_cameras.py a.mp4 b.mp4 c.mp4 --out results

Without further arguments people are found by what moves before the background, and cameras and
ground from the people. `--detector yolo11x-pose.onnx --embedder osnet.onnx` take networks instead,
`--scene scene.json` a known calibration.
"""

import argparse

import catfree as cf
from catfree import run_stages, write_results


def main() -> None:
    """Run every stage, keep what is finished, write the results."""
    parser = argparse.ArgumentParser(description="Track people with several static cameras.")
    parser.add_argument("videos", nargs="+", help="one video file or image folder a camera")
    parser.add_argument("--detector", help="ONNX file of YOLO11-pose or YOLOv8-pose")
    parser.add_argument("--embedder", help="ONNX file of a re-identification network")
    parser.add_argument("--scene", help="scene.json of a known calibration")
    parser.add_argument("--stride", type=int, default=1, help="use every so-many-th frame")
    parser.add_argument("--out", default="results", help="folder for the results")
    asked = parser.parse_args()

    outcome = run_stages(
        cf.adapters.SynchronizedVideos(asked.videos, stride=asked.stride),
        detector=cf.adapters.YoloPoseOnnx(asked.detector) if asked.detector else None,
        embedder=cf.adapters.ReIdOnnx(asked.embedder) if asked.embedder else None,
        scene=cf.adapters.read_scene_json(asked.scene)[0] if asked.scene else None,
        cache_dir=f"{asked.out}/cache",
        progress=lambda stage, done, total: print(f"\r{stage} {done}/{total}   ", end=""),
    )
    write_results(asked.out, outcome)
    tracks = outcome.localization.tracks
    print(f"\n{len(set(tracks.track_id.tolist()))} tracks; see {asked.out}/report.html")


if __name__ == "__main__":
    main()
