"""Constants and result of the refinement of a rig."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from catfree.types import Scene

CAMERAS = 3  # least number that must see a person
STEPS = 10  # bundle adjustment steps per round
MOST_FRAMES = 200  # a static rig needs people in many places, not every frame


@dataclass(frozen=True)
class Refinement:
    """A refined scene and the residuals of all rounds.

    Attributes:
        scene: the scene of the chosen round.
        residuals: (rounds done + 1,) median angle in radians between the rays of people seen by
            enough cameras and their positions; the first entry is for the given scene.
        chosen: the round with the smallest residual; 0 is the given scene.
        people: (rounds done + 1,) number of these people.
    """

    scene: Scene
    residuals: Float[np.ndarray, " round"]
    chosen: int
    people: Int[np.ndarray, " round"]
