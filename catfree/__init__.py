"""catfree: tracked pedestrian ground positions from synchronized static cameras.

No supplied calibration, no position labels, no training on the scene.
"""

from catfree import (
    adapters as adapters,
    evaluation as evaluation,
    filters as filters,
    geometry as geometry,
)
from catfree.coverage import (
    Coverage as Coverage,
    camera_gain as camera_gain,
    coverage as coverage,
    rank_cameras as rank_cameras,
)
from catfree.errors import CatFreeError as CatFreeError
from catfree.pipeline import localize as localize
from catfree.rig import (
    Calibration as Calibration,
    Refinement as Refinement,
    calibrate as calibrate,
    refine as refine,
)
from catfree.run import run as run
from catfree.settings import Settings as Settings
from catfree.types import (
    Candidates as Candidates,
    Detections as Detections,
    Fate as Fate,
    Localization as Localization,
    Origin as Origin,
    Plane as Plane,
    Rays as Rays,
    Rig as Rig,
    Scene as Scene,
    Tracks as Tracks,
)

__version__ = "0.1.0"
