"""Detections in canonical order, with a table per frame and camera."""

from contextlib import AbstractContextManager
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.geometry._buckets import padded_length
from catfree.geometry._person import cut_by_border, edges_of
from catfree.geometry.camera import rays_of_pixels
from catfree.methods.evidence.observe._embeddings import Embeddings, embeddings_of
from catfree.methods.evidence.observe._hidden_shares import hidden_shares
from catfree.methods.evidence.observe._local_pinholes import local_pinholes, project_rays
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Lens, Rig

PAIRS_OF_A_RUN = 1 << 24  # of boxes of the same instant
PINHOLES_BLOCK = 64  # the boxes' own pinholes are padded to this times a power of two
LONGEST_PAUSE = 1e6  # usual steps; after such a pause anybody may be anywhere


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes sorted by frame, camera and edges.

    Attributes:
        row: (N,) original index.
        frames: (F,) distinct frame numbers, sorted.
        frame: (N,) index into `frames`.
        camera: (N,) camera index.
        box: (N, 4) x1, y1, x2, y2 in original pixels, in the caller's float width.
        edges: (N, 3) center column, top row, bottom row in pixels of the box's pinhole: its camera
            without distortion or, for other lenses, a pinhole of its own (`local_pinholes`).
        view: (N,) index of the box's pinhole: its camera, or C plus a row of `K` and `R`.
        K: (V, 3, 3) intrinsics of the boxes' own pinholes; V is 0 if all cameras are pinholes.
        R: (V, 3, 3) their world-to-camera rotations.
        cut: (N, 3) whether the side, top or bottom is cut by the image border.
        ankles: (N,) whether ankles are confirmed; true if ankles were not checked.
        covered: (N,) share of the lower part hidden by boxes in front of it.
        valid: (N,) whether the pixels have rays.
        table: (F, C, B) rows of each frame and camera, -1 for none.
        embedding: embeddings of the boxes; None if absent or unused.
        first: (F + 1,) first row of each frame.
        silent: (F, C) whether a camera's picture of a frame is known to be missing.
    """

    row: Int[np.ndarray, " box"]
    frames: Int[np.ndarray, " frame"]
    frame: Int[np.ndarray, " box"]
    camera: Int[np.ndarray, " box"]
    box: Float[np.ndarray, "box 4"]
    edges: Float[np.ndarray, "box 3"]
    view: Int[np.ndarray, " box"]
    K: Float[np.ndarray, "view 3 3"]
    R: Float[np.ndarray, "view 3 3"]
    cut: Bool[np.ndarray, "box 3"]
    ankles: Bool[np.ndarray, " box"]
    covered: Float[np.ndarray, " box"]
    valid: Bool[np.ndarray, " box"]
    table: Int[np.ndarray, "frame cam slot"]
    embedding: Embeddings | None
    first: Int[np.ndarray, " bounds"]
    silent: Bool[np.ndarray, "frame cam"]

    @property
    def size(self) -> Float[np.ndarray, " box"]:
        """(N,) height in pixels of the box's pinhole."""
        return np.maximum(self.edges[:, 2] - self.edges[:, 1], 1.0)

    @property
    def step(self) -> float:
        """The usual step between frame numbers: their median; 1 for fewer than two."""
        return float(np.median(np.diff(self.frames))) if len(self.frames) > 1 else 1.0

    @property
    def runs(self) -> list[tuple[int, int]]:
        """Runs of frames, as (first, end), whose pairs of boxes fit into memory together."""
        frames, fullest = len(self.frames), int(np.diff(self.first).max(initial=1))
        step = max(1, PAIRS_OF_A_RUN // fullest**2)
        return [(begin, min(begin + step, frames)) for begin in range(0, max(frames, 1), step)]

    @property
    def time(self) -> Float[np.ndarray, " frame"]:
        """Time of each frame in usual steps, with pauses limited to `LONGEST_PAUSE`."""
        # Subtract as integers: frame numbers may be nanoseconds since 1970.
        pause = np.diff(self.frames, prepend=self.frames[:1])
        longest = int(min(LONGEST_PAUSE * self.step, 2.0**62))
        beyond = np.cumsum(np.maximum(pause - longest, 0))
        return (self.frames - self.frames[:1] - beyond).astype(float) / self.step


def float_width_of(box: Float[np.ndarray, "n 4"]) -> AbstractContextManager[None]:
    """Let compiled functions compute in the float width of the boxes.

    Single precision costs up to 0.23 MODA on real boxes. Sums over boxes need double precision, in
    which the host computes them.
    """
    return jax.enable_x64(box.dtype == np.float64)


def undistorted_pixels(
    rig: Rig, camera: Int[np.ndarray, " n"], pixel: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Undistort pixels to a pinhole camera with the same K.

    Args:
        rig: the cameras, which must be pinholes.
        camera: (n,) camera of each pixel.
        pixel: (n, 2) as observed.

    Returns:
        (n, 2) in float64; the input pixels if the rig has no distortion.
    """
    if rig.distortion is None:
        return pixel
    K, R = (np.asarray(part, np.float64)[camera] for part in (rig.K, rig.R))
    return project_rays(K, R, rays_of_pixels(rig, camera, pixel))[0]


def prepare_boxes(
    detections: Detections,
    rig: Rig,
    settings: EvidenceSettings,
    silent: Int[np.ndarray, "k 2"] | None = None,
    frames: Int[np.ndarray, " frame"] | None = None,
    keep: Bool[np.ndarray, " n"] | None = None,
) -> Boxes:
    """Sort and undistort detections, dropping those of unregistered cameras.

    Args:
        detections: boxes in any order.
        rig: the cameras.
        settings: for the border margin, the lower part of a body, and whether to use embeddings.
        silent: (K, 2) frame and camera of missing pictures.
        frames: (F,) sorted frame numbers, with or without boxes; None for those with boxes.
        keep: (N,) detections to use; None for all.

    Returns:
        Arrays in an order that does not depend on the input order.
    """
    usable = np.isin(detections.camera, np.flatnonzero(rig.registered))
    rows = np.flatnonzero(usable if keep is None else usable & keep)
    box = np.asarray(detections.box, np.float64)
    keys = [box[rows, i] for i in (3, 2, 1, 0)] + [detections.camera[rows], detections.frame[rows]]
    order = np.lexsort(keys)
    place = np.column_stack(keys)[order]
    if (place[1:] == place[:-1]).all(1).any():  # identical boxes: sort by ankles and embedding
        if detections.ankles_confirmed is not None:
            keys.insert(0, detections.ankles_confirmed[rows])
        if detections.embedding is not None:
            keys = [*detections.embedding[rows].T, *keys]
        order = np.lexsort(keys)
    rows = rows[order]
    n = len(rows)
    if frames is None:
        frames = np.unique(detections.frame[rows])
    frame = np.searchsorted(frames, detections.frame[rows])
    camera = detections.camera[rows]
    box = box[rows]
    middle = (box[:, 0] + box[:, 2]) / 2
    head, foot = (np.stack([middle, box[:, edge]], -1) for edge in (1, 3))
    valid, view = np.ones(n, bool), camera
    K = R = np.zeros((0, 3, 3))
    non_pinhole = np.flatnonzero(rig.lenses[camera] != Lens.PINHOLE)
    straight_head, straight_foot = (undistorted_pixels(rig, camera, p).copy() for p in (head, foot))
    if len(non_pinhole):
        center = np.stack([middle, (box[:, 1] + box[:, 3]) / 2], -1)[non_pinhole]
        K, R, usable = local_pinholes(rig, camera[non_pinhole], center)
        for pixel, straight in ((head, straight_head), (foot, straight_foot)):
            ray = rays_of_pixels(rig, camera[non_pinhole], pixel[non_pinhole])
            straight[non_pinhole], in_front = project_rays(K, R, ray)
            usable &= in_front
        valid[non_pinhole] = usable
        view = view.copy()
        view[non_pinhole] = rig.camera_count + np.arange(len(non_pinhole))
        # Padded, so that few sizes are compiled.
        length = padded_length(len(non_pinhole), PINHOLES_BLOCK, factor=2)
        rest = ((0, length - len(non_pinhole)), (0, 0), (0, 0))
        K, R = (np.pad(part, rest, mode="edge") for part in (K, R))
    edges = edges_of(straight_head, straight_foot)
    cut = cut_by_border(box, rig.image_size[camera], settings.border_margin)
    ankles = (
        np.ones(n, bool)
        if detections.ankles_confirmed is None
        else detections.ankles_confirmed[rows]
    )

    F = len(frames)
    table = _row_table(frame, camera, F, rig.camera_count)
    feet = box.copy()
    feet[:, 1] = feet[:, 3] - settings.lower_body * (feet[:, 3] - feet[:, 1])
    embedding = None
    if detections.embedding is not None and settings.use_appearance:
        embedding = embeddings_of(detections.embedding, rows)
    return Boxes(
        row=rows,
        frames=frames,
        frame=frame,
        camera=camera,
        box=detections.box[rows],
        edges=edges,
        view=view,
        K=K,
        R=R,
        cut=cut,
        ankles=ankles,
        covered=hidden_shares(feet, np.arange(n), frame, camera, box, table),
        valid=valid,
        table=table,
        embedding=embedding,
        first=np.searchsorted(frame, np.arange(F + 1)),
        silent=_silent_table(silent, frames, rig.camera_count),
    )


def _silent_table(
    silent: Int[np.ndarray, "k 2"] | None, frames: Int[np.ndarray, " frame"], cameras: int
) -> Bool[np.ndarray, "frame cam"]:
    """(F, C) mask from (K, 2) rows of frame and camera; rows of other frames are ignored."""
    table = np.zeros((len(frames), cameras), bool)
    if silent is not None:
        rows = silent[np.isin(silent[:, 0], frames)]
        table[np.searchsorted(frames, rows[:, 0]), rows[:, 1]] = True
    return table


def _row_table(frame: np.ndarray, camera: np.ndarray, F: int, C: int) -> np.ndarray:
    """(F, C, B) table of rows by frame and camera; the input is sorted by frame, then camera."""
    key = frame * C + camera
    start = np.searchsorted(key, np.arange(F * C))
    slot = np.arange(len(key)) - start[key]
    table = np.full((F * C, slot.max(initial=0) + 1), -1)
    table[key, slot] = np.arange(len(key))
    return table.reshape(F, C, table.shape[1])
