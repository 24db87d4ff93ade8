"""Track people with your own cameras.

    python examples/own_cameras.py a.mp4 b.mp4 c.mp4 --out results

By default, people are found by background subtraction, and cameras and ground from the people. Use
`--detector yolo11x-pose.onnx --embedder osnet.onnx` for networks and `--scene` for a known
calibration: scene.json, a COLMAP model, ...
"""

import argparse

import catfree as cf
from catfree import run_stages, write_results


def main() -> None:
    """Run all stages with a cache and write the results."""
    parser = argparse.ArgumentParser(description="Track people with several static cameras.")
    parser.add_argument("videos", nargs="+", help="one video file or image folder per camera")
    parser.add_argument("--detector", help="ONNX file of YOLO11-pose or YOLOv8-pose")
    parser.add_argument("--embedder", help="ONNX file of a re-identification network")
    parser.add_argument("--scene", help="known calibration, as cf.read_scene reads it")
    parser.add_argument("--stride", type=int, default=1, help="use every n-th frame")
    parser.add_argument("--out", default="results", help="folder for the results")
    options = parser.parse_args()

    outcome = run_stages(
        cf.adapters.SynchronizedVideos(options.videos, stride=options.stride),
        detector=cf.adapters.YoloPoseOnnx(options.detector) if options.detector else None,
        embedder=cf.adapters.ReIdOnnx(options.embedder) if options.embedder else None,
        scene=options.scene,  # a path, so its cameras are matched to the videos by name
        cache_dir=f"{options.out}/cache",
        progress=lambda stage, done, total: print(f"\r{stage} {done}/{total}   ", end=""),
    )
    write_results(options.out, outcome, videos=outcome.videos)
    tracks = outcome.localization.tracks
    print(f"\n{len(set(tracks.track_id.tolist()))} tracks; see {options.out}/report.html")


if __name__ == "__main__":
    main()
