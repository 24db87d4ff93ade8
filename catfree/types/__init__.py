"""Frozen struct-of-arrays types that the stages exchange."""

from catfree.types import _processes as _processes  # detects forks made after this import
from catfree.types._clock import Clock as Clock
from catfree.types._detections import Detections as Detections
from catfree.types._georeference import GeoReference as GeoReference
from catfree.types._rig import Lens as Lens, Rig as Rig
from catfree.types._scene import Plane as Plane, Rays as Rays, Scene as Scene
from catfree.types.results._localization import (
    Candidates as Candidates,
    Fate as Fate,
    Localization as Localization,
    Reliability as Reliability,
    Thresholds as Thresholds,
)
from catfree.types.results._tracks import Origin as Origin, Tracks as Tracks
