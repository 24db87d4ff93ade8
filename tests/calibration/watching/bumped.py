"""Recordings whose cameras turn or whose clocks go wrong, by known amounts."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from catfree.types import Clock


def turn_camera(detections, rig, camera, turn, since):
    """Move the boxes of a pinhole camera as if it turned by a rotation vector from a frame on."""
    K = np.asarray(rig.K, float)[camera]
    map_ = K @ Rotation.from_rotvec(turn).as_matrix() @ np.linalg.inv(K)
    size = np.asarray(rig.image_size)[camera]
    mine = (detections.camera == camera) & (detections.frame >= since)
    x1, y1, x2, y2 = np.asarray(detections.box, float)[mine].T
    middle, half = (x1 + x2) / 2, (x2 - x1) / 2

    def moved(y):
        u, v, w = map_ @ np.stack([middle, y, np.ones_like(y)])
        return u / w, v / w

    (head, top), (foot, bottom) = moved(y1), moved(y2)
    middle = (head + foot) / 2
    box = np.array(detections.box, float)
    box[mine] = np.stack([middle - half, top, middle + half, bottom], -1)
    box[mine] = np.clip(box[mine], 0, np.tile(size - 1, 2))
    kept = (box[:, 2] - box[:, 0] > 2) & (box[:, 3] - box[:, 1] > 8)
    return replace(detections, box=np.where(kept[:, None], box, detections.box))[kept]


def renumber(detections, camera, lag):
    """Increase a camera's frame numbers by `lag(frame)` frames."""
    frame = detections.frame.copy()
    mine = detections.camera == camera
    frame[mine] += np.rint(lag(frame[mine])).astype(int)
    return replace(detections, frame=frame)


def on_clock(detections, frame_rate):
    """Put the boxes on a clock."""
    return replace(detections, clock=Clock(frame_rate))
