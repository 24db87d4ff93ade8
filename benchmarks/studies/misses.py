"""MODA against the miss rate: `python -m benchmarks.studies.misses --out results`.

The rate applies to people who are large and fully visible; hidden or distant people are missed more
often, and a miss lasts half a second on average.
"""

from benchmarks.studies.sweep import Sequence, Study, detector, main, simulate


def missing(percent: float, seed: int, frames: int) -> Sequence:
    """Simulate a world whose detector misses `percent` of the people in plain view."""
    return simulate(seed, frames, detector=detector(detection_rate=1 - percent / 100))


STUDY = Study(
    name="misses",
    title="Missed people",
    axis="people in plain view that a camera misses (%)",
    values=(0, 10, 20, 30, 45, 60),
    quick=(0, 30),
    sequence=missing,
)

if __name__ == "__main__":
    main(STUDY)
