"""The constants of a run that may be set, frozen, one dataclass a stage."""

from catfree.settings.calibration import CalibrationSettings as CalibrationSettings
from catfree.settings.combined import Settings as Settings
from catfree.settings.evidence import EvidenceSettings as EvidenceSettings
from catfree.settings.paper import (
    AssociationSettings as AssociationSettings,
    RaySettings as RaySettings,
    Selection as Selection,
    SelectionSettings as SelectionSettings,
    TrackletSettings as TrackletSettings,
    TrajectorySettings as TrajectorySettings,
    TriangulationSettings as TriangulationSettings,
)
