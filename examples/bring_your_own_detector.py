"""Plug in a detector of your own.

    python examples/bring_your_own_detector.py a.mp4 b.mp4 c.mp4

A detector is any callable from an image to boxes. This one first learns the background from a
camera's footage (`fit`) and detects what differs from it. It needs no weights, but merges people
who stand close together: replace it with your own. A detector that does not learn from the footage
needs only `__call__` and `fingerprint`.
"""

import argparse
from collections.abc import Iterable
from itertools import islice

import cv2
import numpy as np

import catfree as cf

DIFFERENCE = 30  # gray levels
SMALLEST = 24  # pixels in height
SAMPLED = 100, 2  # background from every second of the first 100 images


class Moving:
    """Detect tall regions that differ from the background."""

    fingerprint = "moving-1"  # change it with the code, so no stale result is reused

    def fit(self, images: Iterable[np.ndarray]) -> "MovingAt":
        """Learn the background of one camera from its RGB images."""
        some = list(islice(images, 0, *SAMPLED))
        return MovingAt(np.median(some, axis=0).astype(np.uint8))


class MovingAt:
    """`Moving`, fitted to one camera."""

    fingerprint = Moving.fingerprint

    def __init__(self, usual: np.ndarray) -> None:
        self.usual = usual

    def __call__(self, image: np.ndarray) -> cf.adapters.FrameDetections:
        """Detect the people in one RGB image."""
        changed = (cv2.absdiff(image, self.usual).max(axis=2) > DIFFERENCE).astype(np.uint8)
        whole = cv2.morphologyEx(changed, cv2.MORPH_CLOSE, np.ones((15, 5), np.uint8))
        _, _, blobs, _ = cv2.connectedComponentsWithStats(whole)
        x, y, width, height, area = blobs[1:].T
        person = (height >= SMALLEST) & (height > 1.5 * width) & (area > 0.3 * width * height)
        box = np.stack([x, y, x + width, y + height], axis=-1)[person].astype(np.float64)
        return cf.adapters.FrameDetections(box, np.full(len(box), 0.9))


def main() -> None:
    """Run with this detector and print the positions."""
    parser = argparse.ArgumentParser(description="Track people with a detector of your own.")
    parser.add_argument("videos", nargs="+", help="one video file or image folder per camera")
    parser.add_argument("--scene", help="known calibration, as cf.read_scene reads it")
    options = parser.parse_args()
    tracks = cf.run(options.videos, detector=Moving(), scene=options.scene).tracks
    for frame, person, x, y in tracks.to_rows():
        print(f"frame {frame:.0f}: person {person:.0f} at {x:.2f} m, {y:.2f} m")


if __name__ == "__main__":
    main()
