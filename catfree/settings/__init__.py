"""Settings of a run: one frozen dataclass per stage."""

from catfree.settings._calibration_settings import CalibrationSettings as CalibrationSettings
from catfree.settings._evidence_settings import EvidenceSettings as EvidenceSettings
from catfree.settings._paper_settings import (
    AssociationSettings as AssociationSettings,
    RaySettings as RaySettings,
    Selection as Selection,
    SelectionSettings as SelectionSettings,
    TrackletSettings as TrackletSettings,
    TrajectorySettings as TrajectorySettings,
    TriangulationSettings as TriangulationSettings,
)
from catfree.settings._settings import Settings as Settings
