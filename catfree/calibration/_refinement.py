"""Settings and result of the refinement of a rig."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from catfree.calibration._bundle_adjustment import CameraTie
from catfree.settings._checked_settings import CheckedSettings
from catfree.types import Scene

SAME_RESIDUAL = 0.01  # relative difference below which residuals count as equal


@dataclass(frozen=True)
class RefinementSettings(CheckedSettings):
    """Settings of the refinement.

    Attributes:
        cameras: minimum number of cameras that see a person used as a reference point; the evidence
            method also requires half of all cameras.
        iterations: steps of the bundle adjustment per round.
        tie: standard deviations of the cameras from the given rig.
        maximum_frames: maximum number of frames used, evenly spread: a static rig needs people in
            many places, not every frame. The evidence method uses short runs of frames.
        refit_ground: move the ground to the feet of the people of the chosen round.
        ground_tilt: standard deviation in radians of the given ground's tilt about each axis; used
            only by the paper's method, since whole boxes determine the ground.
        ground_offset: standard deviation of the ground's offset as a fraction of E; used only by
            the paper's method.
    """

    not_zero = frozenset({"cameras", "maximum_frames", "ground_tilt", "ground_offset"})

    cameras: int = 3
    iterations: int = 10
    tie: CameraTie = field(default_factory=CameraTie)
    maximum_frames: int = 200
    refit_ground: bool = True
    ground_tilt: float = np.deg2rad(2.0)
    ground_offset: float = 0.03


@dataclass(frozen=True)
class Refinement:
    """A refined scene and the residuals of all rounds.

    Attributes:
        scene: the scene of the chosen round.
        residuals: (rounds done + 1,) median angle in radians between the rays of people seen by
            enough cameras and their positions; the first is that of the given scene.
        chosen: the round with the smallest residual; 0 is the given scene.
        people: (rounds done + 1,) number of those people.
    """

    scene: Scene
    residuals: Float[np.ndarray, " round"]
    chosen: int
    people: Int[np.ndarray, " round"]
