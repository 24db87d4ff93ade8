"""`EvidenceState`: everything that the evidence method knows about a sequence."""

from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.methods.evidence._gaussian import mean_and_covariance
from catfree.methods.evidence.group._appearance import GroupLooks, PairRatios, no_looks
from catfree.methods.evidence.group._groups import Groups
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._measurement import Measurements, Noise
from catfree.methods.evidence.observe._views import GroundViews
from catfree.methods.evidence.observe._visibility import DetectionRate
from catfree.methods.evidence.track._existence import Existence, not_judged
from catfree.methods.evidence.track._tracking import (
    Motion,
    Population,
    Trails,
    no_trails,
)
from catfree.settings import EvidenceSettings
from catfree.types import Fate


class EvidenceState(eqx.Module):
    """Everything known so far, in units of H0 on the plane (see `GroundViews`).

    A state is always complete: until their passes have run, there are no groups, tracks or reported
    rows, and learned quantities have their initial values.

    Attributes:
        boxes, views, noise, measurements: the boxes, their cameras, noise and likelihoods.
        ratios: compares the embeddings of boxes; None if they do not discriminate people.
        groups: boxes of one person in one frame.
        place: (H, 3) position and height of each group.
        rate: detection rate of each camera.
        existence: the evidence for each group.
        motion: motion model of the people.
        trails: the tracks; `evidence`: (M,) log-odds of each of their rows.
        probability: (M,) that the person was present.
        position_covariance: (M, 2, 2) with sway, uneven ground and pose errors, as reported.
        coverage: (M, 2) ground uncertainty and number of images with the whole body, both without
            occlusion, of reported rows and those outside the working area; NaN for others.
        fate: (M,) values of `Fate`: why a row is not reported; `TRACKING` where nobody is present.
        identity: (M,) identity of reported rows; -1 for others.
    """

    boxes: Boxes
    views: GroundViews
    noise: Noise
    measurements: Measurements
    ratios: PairRatios | None
    groups: Groups
    place: Float[np.ndarray, "group 3"]
    rate: DetectionRate
    existence: Existence
    motion: Motion
    trails: Trails
    evidence: Float[np.ndarray, " node"]
    probability: Float[np.ndarray, " node"]
    position_covariance: Float[np.ndarray, "node 2 2"]
    coverage: Float[np.ndarray, "node 2"]
    fate: Int[np.ndarray, " node"]
    identity: Int[np.ndarray, " node"]

    @property
    def kept(self) -> Bool[np.ndarray, " node"]:
        """(M,) whether the row is reported."""
        return self.fate == Fate.ACCEPTED

    @property
    def shown(self) -> Int[np.ndarray, " k"]:
        """(k,) the reported rows with boxes."""
        return np.flatnonzero(self.kept & (self.trails.group >= 0))

    def population(self, settings: EvidenceSettings, dim: int = 0) -> Population:
        """The quantities common to all people and frames.

        Args:
            settings: constants and switches.
            dim: embedding length to use if embeddings are uninformative.
        """
        density, spread = float(self.noise.density), float(self.noise.spread)
        looks, likeness = no_looks(len(self.groups), dim), None
        if self.ratios is not None and settings.link_by_looks:
            looks = GroupLooks(self.ratios.embedding, self.groups.member)
            likeness = self.ratios.likeness
        time, motion = self.boxes.time, self.motion
        return Population(time, motion, density, spread, settings, looks, likeness)

    def is_tracked(self, settings: EvidenceSettings) -> bool:
        """Return whether people are tracked over time, which needs more than one instant."""
        return settings.track and settings.passes > 0 and len(self.boxes.frames) > 1


def with_groups(state: EvidenceState, groups: Groups) -> EvidenceState:
    """Replace the groups, dropping the old tracks and everything known about the old groups."""
    place, _ = mean_and_covariance(groups.info, float(state.noise.spread))
    return replace(
        with_tracks(state, no_trails(), np.zeros(0), np.zeros(0)),
        groups=groups,
        place=place,
        existence=not_judged(*groups.member.shape),
    )


def with_tracks(
    state: EvidenceState,
    trails: Trails,
    evidence: Float[np.ndarray, " node"],
    probability: Float[np.ndarray, " node"],
) -> EvidenceState:
    """Replace the tracks, without reporting any of them yet."""
    return replace(
        state,
        trails=trails,
        evidence=evidence,
        probability=probability,
        position_covariance=trails.covariance[:, :2, :2],
        coverage=np.full((len(trails), 2), np.nan),
        fate=np.full(len(trails), Fate.TRACKING),
        identity=np.full(len(trails), -1),
    )
