"""Inputs of the bundle adjustment: boxes of matched people and a prior on the cameras."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class BoxMeasurements:
    """Boxes of people seen by several cameras, sorted by person.

    Attributes:
        person: (n,) index of the person, ascending, without gaps.
        camera: (n,) index of the camera.
        box: (n, 3) center, top row, bottom row in pixels from the image center.
        sd: (n, 3) standard deviations in pixels.
    """

    person: Int[np.ndarray, " n"]
    camera: Int[np.ndarray, " n"]
    box: Float[np.ndarray, "n 3"]
    sd: Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class KnownCameras:
    """Gaussian prior on the cameras, which also fixes the gauge.

    Attributes:
        parameters: (C, 7) its mean.
        precision: (C, 7) inverse variances; 0 is uninformative.
    """

    parameters: Float[np.ndarray, "cam 7"]
    precision: Float[np.ndarray, "cam 7"]
