"""What a refinement of a rig is asked to do, and what it returns."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration._bundle_adjustment import CameraTie
from catfree.types import Scene

SAME_RESIDUAL = 0.01  # share; rounds whose residuals differ by less are as good


@dataclass(frozen=True)
class RefinementSettings:
    """How the rig is refined.

    Attributes:
        cameras: cameras that must see a person for it to be a reference point; the evidence method
            asks for half of all cameras besides.
        iterations: steps of the bundle adjustment in each round.
        tie: how far the cameras may be from the rig that was given.
        maximum_frames: at most so many frames, evenly spread, take part: a static rig needs people
            in many places, not every frame. The evidence method takes short runs of them.
        refit_ground: move the ground to the feet of the people of the chosen round.
        ground_tilt: standard deviation in radians of the given ground's tilt about each axis; only
            the paper's method needs it, since whole boxes say where the ground is.
        ground_offset: standard deviation of its offset as a share of E; likewise.
    """

    cameras: int = 3
    iterations: int = 10
    tie: CameraTie = field(default_factory=CameraTie)
    maximum_frames: int = 200
    refit_ground: bool = True
    ground_tilt: float = np.deg2rad(2.0)
    ground_offset: float = 0.03


@dataclass(frozen=True)
class Refinement:
    """A refined scene and how it came about.

    Attributes:
        scene: the scene of the chosen round.
        residuals: (rounds done + 1,) median angle in radians between the rays of people seen by
            enough cameras and their positions; the first is that of the scene that was given.
        chosen: the round with the smallest one; 0 returns what was given.
        people: (rounds done + 1,) number of those people.
    """

    scene: Scene
    residuals: Float[np.ndarray, " round"]
    chosen: int
    people: Int[np.ndarray, " round"]
