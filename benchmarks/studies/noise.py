"""MODA against the detector's noise: `python -m benchmarks.studies.noise --out results`.

Every side of every box has a Gaussian error whose standard deviation is this share of the box
height, plus one pixel; at 10 %, the share is 17 pixels for a person of 170 pixels.
"""

from benchmarks.studies.sweep import Sequence, Study, detector, main, simulate


def noisy(percent: float, seed: int, frames: int) -> Sequence:
    """Simulate a world whose box sides are off by `percent` of the box height."""
    return simulate(seed, frames, detector=detector(box_noise=percent / 100))


STUDY = Study(
    name="noise",
    title="Noise of the boxes",
    axis="standard deviation of a box side (% of its height)",
    values=(0, 1.2, 2.5, 5, 7.5, 10),
    quick=(0, 5),
    sequence=noisy,
)

if __name__ == "__main__":
    main(STUDY)
