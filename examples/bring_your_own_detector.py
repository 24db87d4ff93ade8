"""Plug in a detector of your own in ten lines.

    python examples/bring_your_own_detector.py a.mp4 b.mp4 c.mp4

Any object fits that takes a picture and gives boxes. This one is OpenCV's pedestrian detector of
2005, which needs no weights and is not good: put your own in its place.
"""

import sys

import cv2
import numpy as np

import catfree as cf


class HogDetector:
    """Histograms of oriented gradients and a linear classifier (Dalal and Triggs, 2005)."""

    fingerprint = "opencv-hog-1"  # change it with the weights, so that no stale result is reused

    def __init__(self) -> None:
        self.network = cv2.HOGDescriptor()
        self.network.setSVMDetector(cv2.HOGDescriptor.getDefaultPeopleDetector())

    def __call__(self, image: np.ndarray) -> cf.adapters.FrameDetections:
        """The people in one RGB picture."""
        found, weight = self.network.detectMultiScale(image, winStride=(8, 8))
        box = np.array([[x, y, x + w, y + h] for x, y, w, h in found], np.float64)
        return cf.adapters.FrameDetections(box, np.clip(np.ravel(weight), 0, 1))


if __name__ == "__main__":
    from catfree.run import run

    tracks = run(sys.argv[1:], detector=HogDetector()).tracks
    for frame, person, x, y in tracks.to_rows():
        print(f"frame {frame:.0f}: person {person:.0f} at {x:.2f} m, {y:.2f} m")
