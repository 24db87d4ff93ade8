"""catfree: tracked pedestrian ground positions from synchronized static cameras.

No supplied calibration, no position labels, no training on the scene.
"""

from importlib import import_module as _import_module
from types import ModuleType as _ModuleType

from catfree import (
    adapters as adapters,
    calibration as calibration,
    evaluation as evaluation,
    filters as filters,
    geometry as geometry,
    methods as methods,
)
from catfree._coverage import (
    Coverage as Coverage,
    CoverageOptions as CoverageOptions,
    camera_gain as camera_gain,
    coverage as coverage,
    rank_cameras as rank_cameras,
)
from catfree._run import (
    RunOutcome as RunOutcome,
    read_results as read_results,
    run as run,
    run_stages as run_stages,
    write_results as write_results,
)
from catfree.calibration import (
    Calibration as Calibration,
    Refinement as Refinement,
    calibrate as calibrate,
    refine as refine,
)
from catfree.errors import CatFreeError as CatFreeError
from catfree.methods import localize as localize
from catfree.settings import Settings as Settings
from catfree.types import (
    Candidates as Candidates,
    Clock as Clock,
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

__version__ = "0.2.0.dev0"  # the only place: distributions read it from here

_LAZY = ("synthetic", "testing", "viz")  # imported at first use: they need extras, or time

_LISTED = {name for name in globals() if name[0] != "_"}


def __getattr__(name: str) -> _ModuleType:
    if name in _LAZY:
        return _import_module(f"catfree.{name}")
    raise AttributeError(f"module 'catfree' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*_LAZY, *_LISTED})
