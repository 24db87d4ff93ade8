"""The kept detections in a canonical order, so that the caller's order has no effect."""

from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.types import Detections, Rig


class Observations(eqx.Module):
    """Detections sorted by time, camera and box, with the offsets of every (frame, camera) cell.

    Attributes:
        row: (N,) row of each observation in the caller's `Detections`.
        frames: (F,) the distinct frame numbers, ascending.
        frame_index: (N,) index into `frames`.
        time: (F,) whole time steps of `frames`: consecutive frames differ by one.
        kept: (N,) the detections in this order, without embeddings and keypoints.
        appearance: (N, D) unit vectors (zero where the embedding is zero), or None if all are.
        cell_start: (F * C + 1,) first observation of each (frame, camera) cell.
        camera_count: C.
    """

    row: Int[np.ndarray, " n"]
    frames: Int[np.ndarray, " f"]
    frame_index: Int[np.ndarray, " n"]
    time: Int[np.ndarray, " f"]
    kept: Detections
    appearance: Float[np.ndarray, "n d"] | None
    cell_start: Int[np.ndarray, " cells"]
    camera_count: int = eqx.field(static=True)

    def __len__(self) -> int:
        return len(self.row)

    @property
    def cell(self) -> Int[np.ndarray, " n"]:
        """(N,) index of each observation's (frame, camera) cell."""
        return self.frame_index * self.camera_count + self.kept.camera

    def frame_start(self, index: Int[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
        """Return the first observation (K,) of frames by index; for F, the end of the last one."""
        return self.cell_start[index * self.camera_count]


def time_steps(frames: Int[np.ndarray, " f"]) -> Int[np.ndarray, " f"]:
    """Convert ascending frame numbers to whole time steps, where the median distance is one step.

    Annotated sequences often have every fifth frame: 0, 5, 10. A frame without detections leaves
    a gap instead of joining its neighbors. For an even number of distances the lower median is one
    step.
    """
    if len(frames) < 2:
        return np.zeros(len(frames), np.int64)
    distance = np.diff(frames)
    usual = np.sort(distance)[(len(distance) - 1) // 2]
    steps = np.maximum(np.round(distance / usual), 1)
    return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def observe(detections: Detections, rig: Rig, *, keep: Bool[np.ndarray, " n"]) -> Observations:
    """Sort the kept detections by frame, camera and box.

    Args:
        detections: the caller's detections.
        rig: cameras; only their number is used.
        keep: (N,) which detections take part.

    Returns:
        The observations.
    """
    order = np.lexsort([*detections.box.T[::-1], detections.camera, detections.frame])
    row = order[keep[order]]
    seen = detections[row]
    frames, frame_index = np.unique(seen.frame, return_inverse=True)
    cell = frame_index * rig.camera_count + seen.camera
    appearance = None
    if seen.embedding is not None and seen.embedding.any():
        appearance = unit_vectors(seen.embedding.astype(np.float32))
    return Observations(
        row=row,
        frames=frames,
        frame_index=frame_index,
        time=time_steps(frames),
        kept=replace(seen, embedding=None, keypoints=None),
        appearance=appearance,
        cell_start=np.searchsorted(cell, np.arange(len(frames) * rig.camera_count + 1)),
        camera_count=rig.camera_count,
    )


def unit_vectors(appearance: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
    """Divide each row by its length; rows of zeros stay."""
    length = np.linalg.norm(appearance, axis=1, keepdims=True)
    return appearance / np.where(length > 0, length, 1)


def appearance_distance(
    appearance: Float[np.ndarray, "n d"],
    first: Int[np.ndarray, " p"],
    second: Int[np.ndarray, " p"],
) -> Float[np.ndarray, " p"]:
    """Compute the cosine distance in [0, 2] of pairs of unit vectors; 1 where one is zero.

    Computed in slices, so that temporary memory does not grow with the number of pairs.
    """
    distance = np.empty(len(first), np.float32)
    step = max(1, 4_000_000 // max(1, appearance.shape[1]))
    for begin in range(0, len(first), step):
        rows = slice(begin, begin + step)
        similarity = np.einsum("pd,pd->p", appearance[first[rows]], appearance[second[rows]])
        distance[rows] = np.clip(1 - similarity, 0, 2)
    return distance
