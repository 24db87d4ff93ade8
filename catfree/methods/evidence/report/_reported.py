"""Rows to report, and their conversion to tracks in the frame and units of the scene."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from catfree.geometry._plane import from_plan
from catfree.methods.evidence._gaussian import symmetrized
from catfree.types import Clock, Origin, Scene, Tracks


class Reported(NamedTuple):
    """n rows to report, in H0 on the plane.

    Attributes:
        frame: (n,) frame number in the result.
        identity: (n,) identity.
        mean: (n, 5) mean of the state.
        velocity_covariance: (n, 2, 2).
        position_covariance: (n, 2, 2) with sway, uneven ground and pose errors.
        existence: (n,) probability.
        support: (n, C) rows of the caller's detections, or -1.
        coverage: (n, 2) as in `EvidenceState`.
    """

    frame: Int[np.ndarray, " n"]
    identity: Int[np.ndarray, " n"]
    mean: Float[np.ndarray, "n 5"]
    velocity_covariance: Float[np.ndarray, "n 2 2"]
    position_covariance: Float[np.ndarray, "n 2 2"]
    existence: Float[np.ndarray, " n"]
    support: Int[np.ndarray, "n cam"]
    coverage: Float[np.ndarray, "n 2"]


def no_rows(cameras: int) -> Reported:
    """Return an empty set of rows."""
    none, integers, square = np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 2, 2))
    support = np.zeros((0, cameras), np.int64)
    return Reported(
        integers, integers, np.zeros((0, 5)), square, square, none, support, np.zeros((0, 2))
    )


def tracks_of(
    rows: Reported,
    scene: Scene,
    origin: Float[np.ndarray, "2"],
    unit: float,
    pace: float,
    clock: Clock | None = None,
) -> Tracks:
    """Convert rows to the frame and units of the scene.

    Args:
        rows: the rows to report.
        scene: rig and ground.
        origin: (2,) origin of the rows, in plane coordinates of the scene.
        unit: H0 in scene units.
        pace: H0 per step, in scene units per frame of the result.
        clock: clock of the result.
    """
    xy = rows.mean[:, :2] * unit + origin
    covariance = symmetrized(rows.position_covariance) * unit**2
    cameras = (rows.support >= 0).sum(1)
    return Tracks(
        frame=rows.frame,
        track_id=rows.identity,
        position=from_plan(scene, xy),
        ground_xy=xy,
        sigma=np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2),
        covariance=covariance,
        supporting_cameras=cameras,
        origin=np.where(cameras > 0, Origin.DETECTED, Origin.INTERPOLATED).astype(np.int64),
        existence=rows.existence,
        support=rows.support,
        velocity=rows.mean[:, 3:] * pace,
        velocity_covariance=symmetrized(rows.velocity_covariance) * pace**2,
        clock=clock,
        design_sigma=rows.coverage[:, 0] * unit,
        whole_views=rows.coverage[:, 1].astype(np.int64),
    )
