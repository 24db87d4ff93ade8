"""MODA against the error of the rig: `python -m benchmarks.studies.rig --out results`.

Every camera is turned by this angle about a random axis, moved by 0.3 m per degree in a random
direction, and its focal length is off by 4 % per degree: the proportions of `RigError`'s defaults.
The ground keeps those defaults (half a degree, 5 cm).
"""

from benchmarks.studies.sweep import RigError, Sequence, Study, main, simulate


def wrong_rig(degrees: float, seed: int, frames: int) -> Sequence:
    """Simulate a world with cameras off by these degrees, and other errors in proportion."""
    error = RigError(rotation_deg=degrees, centre=0.3 * degrees, focal=0.04 * degrees)
    return simulate(seed, frames, rig_error=error)


STUDY = Study(
    name="rig",
    title="Error of the rig",
    axis="rotation error of every camera (degrees; + 0.3 m, 4 % focal each)",
    values=(0, 0.25, 0.5, 1, 1.5, 2),
    quick=(0, 1),
    sequence=wrong_rig,
)

if __name__ == "__main__":
    main(STUDY)
