"""Track people live in a folder to which cameras write video segments.

    ffmpeg -i rtsp://NORTH -c copy -f segment -segment_time 10 live/north/%06d.mp4   # per camera
    python examples/watch_segments.py live scene.json | tee people.jsonl

A segment is read when all cameras have finished it, that is, when the next one exists; a file
`live/end` says that all segments are finished. People are found by background subtraction, learned
from the first segment: use your own detector for better boxes.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path

import cv2

import catfree as cf


def images(path: Path) -> Iterator[cv2.typing.MatLike]:
    """Yield the pictures of a segment in RGB."""
    video = cv2.VideoCapture(str(path))
    while (read := video.read())[0]:
        yield cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB)


def segments(cameras: list[Path]) -> Iterator[list[Path]]:
    """Yield the files of all cameras for one stretch of time, once they are finished."""
    done = 0
    while True:
        ended = (cameras[0].parent / "end").exists()
        files = [sorted(camera.glob("*.mp4")) for camera in cameras]
        ready = min(map(len, files)) - (0 if ended else 1)
        yield from ([*stretch] for stretch in list(zip(*files, strict=False))[done:ready])
        done = max(done, ready)
        if ended:
            return
        time.sleep(0.5)


def lines(cameras: list[Path], frame_rate: float) -> Iterator[str]:
    """Yield the boxes of each picture as a line of JSON."""
    detectors, frame = None, 0
    for stretch in segments(cameras):
        if detectors is None:
            detectors = [cf.adapters.BackgroundDetector().fit(images(path)) for path in stretch]
        # Stop at the end of the shortest file.
        for pictures in zip(*map(images, stretch), strict=False):
            for camera, detector, picture in zip(cameras, detectors, pictures, strict=True):
                boxes, at = detector(picture).box.tolist(), frame / frame_rate
                yield json.dumps({"camera": camera.name, "time": at, "boxes": boxes})
            frame += 1


def main() -> None:
    """Follow the folder and print positions."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="one folder of segments per camera")
    parser.add_argument("scene", help="cameras and ground, as cf.read_scene reads them")
    parser.add_argument("--frame-rate", type=float, default=5.0, help="of the videos")
    options = parser.parse_args()
    scene, names = cf.read_scene(options.scene)
    rate, cameras = options.frame_rate, [options.folder / name for name in names]
    tracker = cf.Tracker(scene, lag=2.0)
    for record in cf.watch(lines(cameras, rate), tracker, names, frame_rate=rate):
        print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
