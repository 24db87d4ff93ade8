"""catfree: tracked pedestrian ground positions from synchronized static cameras.

No supplied calibration, no position labels, no training on the scene.
"""

import typing as _typing
from importlib import import_module as _import_module

if _typing.TYPE_CHECKING:
    from catfree import (
        adapters as adapters,
        calibration as calibration,
        errors as errors,
        evaluation as evaluation,
        filters as filters,
        geometry as geometry,
        methods as methods,
        settings as settings,
        synthetic as synthetic,
        testing as testing,
        types as types,
        viz as viz,
    )
    from catfree._public import *  # noqa: F403

__version__ = "0.2.0.dev0"  # the only place: distributions read it from here

# Imported at first use, because JAX and OpenCV take seconds, and some packages need extras.
_PACKAGES = (
    "adapters", "calibration", "errors", "evaluation", "filters", "geometry", "methods",
    "settings", "synthetic", "testing", "types", "viz",
)  # fmt: skip


def _names() -> list[str]:
    public = vars(_import_module("catfree._public"))
    return sorted({*_PACKAGES, *(name for name in public if name[0] != "_")})


if not _typing.TYPE_CHECKING:  # which would accept any name

    def __getattr__(name: str) -> _typing.Any:
        if name in _PACKAGES:
            return _import_module(f"catfree.{name}")
        if name == "__all__":
            return _names()
        if name[0] != "_":
            public = vars(_import_module("catfree._public"))
            if name in public:
                return public[name]
        raise AttributeError(f"module 'catfree' has no attribute {name!r}")


def __dir__() -> list[str]:
    return _names()
