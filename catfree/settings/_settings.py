"""Settings of a whole run: the paper's stages, the evidence method, the calibration."""

from dataclasses import dataclass, field
from typing import Literal

from catfree.settings._calibration_settings import CalibrationSettings
from catfree.settings._checked_settings import CheckedSettings
from catfree.settings._evidence_settings import EvidenceSettings
from catfree.settings._paper_settings import (
    AssociationSettings,
    RaySettings,
    SelectionSettings,
    TrackletSettings,
    TrajectorySettings,
    TriangulationSettings,
)

Method = Literal["paper", "evidence"]


@dataclass(frozen=True)
class Settings(CheckedSettings):
    """All settings of a run; `Settings()` is the default method, `Settings.paper()` the paper's.

    Attributes:
        confidence: detections below this score are ignored, if scores exist.
        calibration_confidence: the same for a rig that `run` estimates from people. Correct box
            edges matter more there than detecting everyone, and half-hidden people and doubtful
            splits of groups score lower.
        method: "evidence" for catfree's own method, "paper" for CAT-Free as published.
        rays: the paper's ray reliability.
        tracklets: the paper's per-camera tracks.
        association: the paper's cross-view partition.
        triangulation: the paper's robust position.
        selection: the paper's filters.
        trajectories: the paper's linking and extension.
        evidence: catfree's own method.
        calibration: calibration of the rig from pedestrians only.
    """

    shares = frozenset({"confidence", "calibration_confidence"})

    confidence: float = 0.30
    calibration_confidence: float = 0.55
    method: Method = "evidence"
    rays: RaySettings = field(default_factory=RaySettings)
    tracklets: TrackletSettings = field(default_factory=TrackletSettings)
    association: AssociationSettings = field(default_factory=AssociationSettings)
    triangulation: TriangulationSettings = field(default_factory=TriangulationSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    trajectories: TrajectorySettings = field(default_factory=TrajectorySettings)
    evidence: EvidenceSettings = field(default_factory=EvidenceSettings)
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)

    @classmethod
    def paper(cls) -> "Settings":
        """Settings of the paper: exactly its method and constants."""
        return cls(method="paper")
