"""Cameras that see hardly anybody where others see people."""

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
    """Warn of each camera with hardly any boxes although many reported people are in its view.

    A camera with fewer boxes than the lowest detection rate predicts has no boxes, or only false
    ones.
    """
    boxes, rows = state.boxes, np.flatnonzero(state.kept)
    shown = (boxes.table >= 0).sum((0, 2))
    lowest, _ = settings.detection_rate_range
    blind = scene.rig.registered & (shown < lowest * len(rows))
    if not blind.any():
        return ()
    place, frame = state.trails.mean[rows, :3], state.trails.frame[rows]
    visibility = expected_views(place, frame, boxes, state.views, settings)
    people = (with_pictures(visibility, frame, boxes).inside == 1).sum(0)
    return tuple(
        f"Camera {shown_camera(camera, camera_names)} has {shown[camera]} of the {len(boxes.row)} "
        f"boxes, but {people[camera]} of the positions are in its view: its detector failed, its "
        "video is frozen, covered or of another time, or it delivered no pictures (then pass them "
        "as `silent`)."
        for camera in np.flatnonzero(blind & (shown < lowest * people)).tolist()
    )
