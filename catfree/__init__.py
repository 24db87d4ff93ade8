"""catfree: tracked pedestrian ground positions from synchronized static cameras.

No supplied calibration, no position labels, no training on the scene.
"""

import ast as _ast
import typing as _typing
from functools import cache as _cache
from importlib import import_module as _import_module
from pathlib import Path as _Path

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

__version__ = "0.2.0.dev0"  # the only place: the build reads it from here

# Imported on first use, because JAX and OpenCV take seconds and some packages need extras.
_PACKAGES = (
    "adapters", "calibration", "errors", "evaluation", "filters", "geometry", "methods",
    "settings", "synthetic", "testing", "types", "viz",
)  # fmt: skip


@_cache
def _module_of_name() -> dict[str, str]:
    """Map each name in `_public.py` to its module, without importing any module."""
    source = (_Path(__file__).parent / "_public.py").read_text(encoding="utf-8")
    imports = (node for node in _ast.parse(source).body if isinstance(node, _ast.ImportFrom))
    return {alias.name: str(node.module) for node in imports for alias in node.names}


if not _typing.TYPE_CHECKING:  # type checkers would accept any name

    def __getattr__(name: str) -> _typing.Any:
        if name in _PACKAGES:
            return _import_module(f"catfree.{name}")
        if name == "__all__":
            return __dir__()
        if name in _module_of_name():
            value = globals()[name] = getattr(_import_module(_module_of_name()[name]), name)
            return value
        raise AttributeError(f"module 'catfree' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*_PACKAGES, *_module_of_name()})
