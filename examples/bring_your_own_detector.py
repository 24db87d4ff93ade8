"""Plug in a detector of your own.

    python examples/bring_your_own_detector.py a.mp4 b.mp4 c.mp4

Any object fits that takes a picture and gives boxes. This one wants to see a camera's footage
first (`fit`): people are what differs from the usual picture. It needs no weights and is not good,
since whoever stands beside somebody else is one box with them: put your own in its place. A
detector that needs no footage has `__call__` and `fingerprint` only.
"""

import argparse
from collections.abc import Iterable
from itertools import islice

import cv2
import numpy as np

import catfree as cf

DIFFERENCE = 30  # grey levels
SMALLEST = 24  # pixels of height
SAMPLED = 100, 2  # of so many pictures every so-many-th shows what is usual


class Moving:
    """Boxes of tall things that were not there before."""

    fingerprint = "moving-1"  # change it with the rules, so that no stale result is reused

    def fit(self, images: Iterable[np.ndarray]) -> "MovingAt":
        """The detector for the camera that took these RGB pictures."""
        some = list(islice(images, 0, *SAMPLED))
        return MovingAt(np.median(some, axis=0).astype(np.uint8))


class MovingAt:
    """`Moving` for one camera."""

    fingerprint = Moving.fingerprint

    def __init__(self, usual: np.ndarray) -> None:
        self.usual = usual

    def __call__(self, image: np.ndarray) -> cf.adapters.FrameDetections:
        """The people in one RGB picture."""
        changed = (cv2.absdiff(image, self.usual).max(axis=2) > DIFFERENCE).astype(np.uint8)
        whole = cv2.morphologyEx(changed, cv2.MORPH_CLOSE, np.ones((15, 5), np.uint8))
        _, _, blobs, _ = cv2.connectedComponentsWithStats(whole)
        x, y, width, height, area = blobs[1:].T
        person = (height >= SMALLEST) & (height > 1.5 * width) & (area > 0.3 * width * height)
        box = np.stack([x, y, x + width, y + height], axis=-1)[person].astype(np.float64)
        return cf.adapters.FrameDetections(box, np.full(len(box), 0.9))


def main() -> None:
    """Run with this detector and print who is where."""
    parser = argparse.ArgumentParser(description="Track people with a detector of your own.")
    parser.add_argument("videos", nargs="+", help="one video file or image folder a camera")
    parser.add_argument("--scene", help="scene.json of a known calibration")
    asked = parser.parse_args()
    scene = cf.adapters.read_scene_json(asked.scene)[0] if asked.scene else None
    tracks = cf.run(asked.videos, detector=Moving(), scene=scene).tracks
    for frame, person, x, y in tracks.to_rows():
        print(f"frame {frame:.0f}: person {person:.0f} at {x:.2f} m, {y:.2f} m")


if __name__ == "__main__":
    main()
