"""Temporal consistency: the same two tracklets must match in more than one frame.

Runs in NumPy: the output is a mask over a whole sequence that needs no derivatives, and counting
distinct keys by sorting takes NumPy a few milliseconds. XLA's CPU sort takes tens and is compiled
again for every sequence length.

Source: paper, Sec. "Selecting pedestrian positions", temporal consistency.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from catfree.types._annotations import HostOrDevice
from catfree.types._validation import as_boolean, as_count, as_integer, require_shape


def frames_of_pairs(
    frame: Int[HostOrDevice, " h"],
    tracklet: Int[HostOrDevice, "h cam"],
    where: Bool[HostOrDevice, " h"] | None = None,
) -> Int[np.ndarray, " h"]:
    """Count the frames of the longest-lasting match of each hypothesis.

    A match is a pair of tracklets of two cameras that support one hypothesis. Runs in NumPy, so
    JAX cannot trace it.

    Args:
        frame: (H,) frame of each hypothesis.
        tracklet: (H, C) tracklet of the supporting detection of each camera, -1 where absent.
            Tracklet numbers are unique over all cameras.
        where: (H,) which hypotheses count.

    Returns:
        (H,) largest number of distinct frames in which a pair of the hypothesis occurs; 0 for
        hypotheses that do not count or have fewer than two tracklets.

    Raises:
        InvalidInputError: if an argument is of another kind or shape.
    """
    frame, tracklet = as_integer(frame, "frame"), as_integer(tracklet, "tracklet")
    require_shape(frame, (None,), "frame")
    require_shape(tracklet, (len(frame), None), "tracklet")
    count, cameras = tracklet.shape
    longest = np.zeros(count, np.int64)
    first, second = np.triu_indices(cameras, k=1)
    present = tracklet >= 0
    if where is not None:
        present &= _as_mask(where, count)[:, None]
    row, pair = np.nonzero(present[:, first] & present[:, second])
    names, tracklet_index = np.unique(tracklet, return_inverse=True)
    frames, frame_index = np.unique(frame, return_inverse=True)
    key = tracklet_index[row, first[pair]] * len(names) + tracklet_index[row, second[pair]]
    _, match = np.unique(key, return_inverse=True)
    # Counting makes NumPy sort the distinct numbers, which is far faster than hashing so many.
    in_frame, _ = np.unique(match * len(frames) + frame_index[row], return_counts=True)
    np.maximum.at(longest, row, np.bincount(in_frame // len(frames))[match])
    return longest


def temporally_consistent(
    frame: Int[HostOrDevice, " h"],
    tracklet: Int[HostOrDevice, "h cam"],
    where: Bool[HostOrDevice, " h"] | None = None,
    *,
    minimum_frames: int = 2,
) -> Bool[np.ndarray, " h"]:
    """Select the hypotheses with a match that occurs in several frames.

    Runs in NumPy, so JAX cannot trace it.

    Args:
        frame: (H,) frame of each hypothesis.
        tracklet: (H, C) tracklet of the supporting detection of each camera, -1 where absent.
            Tracklet numbers are unique over all cameras.
        where: (H,) which hypotheses count.
        minimum_frames: number of distinct frames in which one pair of tracklets must occur; 1 or
            less keeps every hypothesis that counts.

    Returns:
        (H,) bool; false where `where` is false.

    Raises:
        InvalidInputError: if an argument is of another kind or shape.
    """
    require_shape(frame, (None,), "frame")
    counted = np.ones(len(frame), bool) if where is None else _as_mask(where, len(frame))
    least = as_count(minimum_frames, "minimum_frames")
    return counted & ((frames_of_pairs(frame, tracklet, counted) >= least) | (least <= 1))


def _as_mask(where: Any, count: int) -> Bool[np.ndarray, " h"]:
    mask = as_boolean(where, "where")
    require_shape(mask, (count,), "where")
    return mask
