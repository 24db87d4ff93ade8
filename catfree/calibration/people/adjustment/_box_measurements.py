"""What an adjustment is given: boxes of known people, and what is known of the cameras."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class BoxMeasurements:
    """Boxes of people who are seen by several cameras, sorted by person.

    Attributes:
        person: (n,) index of the person, ascending, without gaps.
        camera: (n,) index of the camera.
        box: (n, 3) centre, top row, bottom row in pixels from the image centre.
        sd: (n, 3) standard deviations in pixels.
    """

    person: Int[np.ndarray, " n"]
    camera: Int[np.ndarray, " n"]
    box: Float[np.ndarray, "n 3"]
    sd: Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class KnownCameras:
    """Cameras that are roughly known: a Gaussian prior, which fixes the gauge too.

    Attributes:
        parameters: (C, 7) its mean.
        precision: (7,) inverse variances in the order of the parameters; 0 knows nothing.
    """

    parameters: Float[np.ndarray, "cam 7"]
    precision: Float[np.ndarray, "7"]


@dataclass(frozen=True)
class Linearised:
    """Boxes linearised at a state.

    Attributes:
        residual: (n, 3) standardised.
        weight: (n, 3) robust weights.
        by_common: (n, 3, 8) derivatives by the camera and the foot offset, standardised.
        by_person: (n, 3, 3) derivatives by the person's place and height, standardised.
        cost: robust cost with all priors.
    """

    residual: Float[np.ndarray, "n 3"]
    weight: Float[np.ndarray, "n 3"]
    by_common: Float[np.ndarray, "n 3 8"]
    by_person: Float[np.ndarray, "n 3 3"]
    cost: float
