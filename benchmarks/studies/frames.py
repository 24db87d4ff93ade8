"""MODA against the number of frames: `python -m benchmarks.studies.frames --out results`.

The windows of one world share their middle, and only the eight middle frames are scored: the
methods get more or fewer frames, but the scored people are the same.
"""

import dataclasses

import numpy as np

from benchmarks.studies.sweep import Sequence, Study, main, simulate

SCORED = 8
LONGEST = 160


def window(length: float, seed: int, frames: int) -> Sequence:
    """Return the middle `length` frames of a long world; `frames`, its usual length, is unused."""
    whole = simulate(seed, LONGEST)

    def around(count: int) -> np.ndarray:
        return np.arange(LONGEST // 2 - count // 2, LONGEST // 2 + (count + 1) // 2)

    seen = np.isin(whole.detections.frame, around(int(length)))
    return dataclasses.replace(whole, detections=whole.detections[seen], frames=around(SCORED))


STUDY = Study(
    name="frames",
    title="How much video",
    axis="frames (2 a second)",
    values=(8, 16, 32, 64, 160),
    quick=(8, 16),
    sequence=window,
    logarithmic=True,
)

if __name__ == "__main__":
    main(STUDY)
