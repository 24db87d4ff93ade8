"""MODA against the tilt of the ground: `python -m benchmarks.studies.tilt --out results`.

The recovered ground is turned by this angle about a random horizontal axis through the middle of
the area, where it is also 5 cm too high or too low; 10 m away, two degrees are 35 cm.
"""

from benchmarks.studies.sweep import RigError, Sequence, Study, main, simulate


def tilted(degrees: float, seed: int, frames: int) -> Sequence:
    """Simulate a world whose recovered ground is tilted by these degrees."""
    return simulate(seed, frames, rig_error=RigError(ground_tilt_deg=degrees))


STUDY = Study(
    name="tilt",
    title="Tilt of the ground",
    axis="angle between recovered and true ground (degrees)",
    values=(0, 0.5, 1, 2, 3, 4),
    quick=(0, 2),
    sequence=tilted,
)

if __name__ == "__main__":
    main(STUDY)
