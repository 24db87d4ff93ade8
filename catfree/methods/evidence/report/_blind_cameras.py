"""Cameras that see nobody where others see people."""

from collections.abc import Sequence

import numpy as np

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.observe._visibility import expected_views
from catfree.methods.evidence.track._existence import with_pictures
from catfree.settings import EvidenceSettings
from catfree.types import Scene
from catfree.types._validation import shown_camera


def blind_camera_warnings(
    state: EvidenceState,
    scene: Scene,
    settings: EvidenceSettings,
    camera_names: Sequence[str] | None = None,
) -> tuple[str, ...]:
    """One sentence per camera that has not one box, though reported people are in its view."""
    boxes, rows = state.boxes, np.flatnonzero(state.kept)
    blind = scene.rig.registered & (boxes.table < 0).all((0, 2))
    if not blind.any():
        return ()
    place, frame = state.trails.mean[rows, :3], state.trails.frame[rows]
    visibility = expected_views(place, frame, boxes, state.views, settings)
    people = (with_pictures(visibility, frame, boxes).inside == 1).sum(0)
    return tuple(
        f"Camera {shown_camera(camera, camera_names)} has not one box, but {people[camera]} of the "
        "positions are in its view: its detector failed, its video is of another time, or it "
        "delivered no pictures (then say so with `silent`)."
        for camera in np.flatnonzero(blind & (people > 0)).tolist()
    )
