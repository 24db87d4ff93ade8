"""Apparent height of people at each pixel of one camera, learned from its silhouettes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import find_objects

LEAST_AREA = 30  # reduced pixels: a person 12 pixels tall
# A standing person's silhouette is 0.25 to 0.6 times as wide as tall; groups are wider, posts
# narrower.
NARROWEST, WIDEST = 0.2, 0.6
# A person fills half of the silhouette's box; a third leaves room for striding legs.
LEAST_FILLED = 0.33
SMALLEST_HEIGHT = 12  # pixels; below it, one pixel is a tenth of the person
# People differ by 5 % in height (standard deviation), pixels and steps add as much.
TOLERANCE = 0.15
# Columns lower than this share of the blob at its left and right end are remains of shadows.
THIN = 0.15
# Rows and columns: a collar or belt of the background's color does not cut a person in two.
GAP = (7, 1)
LEAST_SILHOUETTES = 12
TRIALS = 300


@dataclass(frozen=True)
class HeightProfile:
    """Apparent height `a v + b u + c` of a standing person with the foot at pixel (u, v).

    On a plane seen by a pinhole camera the height of people is close to linear in the foot pixel.

    Attributes:
        coefficients: (3,) a, b, c in reduced pixels.
    """

    coefficients: Float[np.ndarray, "3"]

    def __call__(self, u: Any, v: Any) -> Any:
        """Return the expected height in pixels; not positive above the horizon."""
        a, b, c = self.coefficients
        return a * v + b * u + c


@dataclass(frozen=True)
class Blobs:
    """Connected parts of a foreground mask.

    Attributes:
        labels: (h, w) 1-based number of each pixel's blob, 0 for background.
        box: (n, 4) x1, y1, x2, y2 of each blob in whole pixels, x2 and y2 exclusive, without thin
            ends at its left and right.
        reach: (n, 4) the same, including the thin ends.
        area: (n,) pixels.
        complete: (n,) false where the blob touches the picture's border.
    """

    labels: Any
    box: Any
    reach: Any
    area: Any
    complete: Bool[np.ndarray, " n"]

    @classmethod
    def find(cls, mask: UInt8[np.ndarray, "h w"]) -> "Blobs":
        """Find the blobs of a mask that are large enough to be a person."""
        import cv2

        joined = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones(GAP, np.uint8))
        _, labels = cv2.connectedComponents(joined, connectivity=8)
        # Few pixels of a picture are in any blob, so only those are counted.
        at = np.flatnonzero(joined.view(bool))
        component = np.asarray(labels, np.int64).ravel()[at] - 1
        area = np.bincount(component)
        kept = area >= LEAST_AREA
        blob_number = np.where(kept, np.cumsum(kept), 0)
        numbered = np.zeros(mask.shape, np.int32)
        numbered.ravel()[at] = blob_number[component]
        corners = [(x.start, y.start, x.stop, y.stop) for y, x in find_objects(numbered)]
        box = np.array(corners, np.int64).reshape(-1, 4)
        rows, columns = mask.shape
        inside = (box[:, :2] > 0) & (box[:, 2:] < [columns, rows])
        complete = np.asarray(inside.all(axis=1))
        trimmed = [_trim(numbered, index, whole) for index, whole in enumerate(corners, start=1)]
        return cls(numbered, np.array(trimmed, np.int64).reshape(-1, 4), box, area[kept], complete)

    def mask_of(self, blobs: Int[np.ndarray, " b"]) -> UInt8[np.ndarray, "h w"]:
        """Mark with 1 the pixels of the given blobs (0-based numbers)."""
        mask = np.zeros(self.labels.shape, np.uint8)
        for blob, (x1, y1, x2, y2) in zip(blobs, self.reach[blobs].tolist(), strict=True):
            mask[y1:y2, x1:x2] |= self.labels[y1:y2, x1:x2] == blob + 1
        return mask

    def alone(self) -> Bool[np.ndarray, " n"]:
        """Return whether each blob has the shape of one whole standing person."""
        width, height = self.box[:, 2] - self.box[:, 0], self.box[:, 3] - self.box[:, 1]
        shape = (width > NARROWEST * height) & (width < WIDEST * height)
        filled = self.area > LEAST_FILLED * width * height  # remains of shadows included
        return self.complete & shape & filled & (height >= SMALLEST_HEIGHT)


def _trim(
    labels: Int[np.ndarray, "h w"], index: int, box: tuple[int, int, int, int]
) -> tuple[int, int, int, int]:
    """Trim a blob's box by its thin ends at the left and right."""
    x1, y1, x2, y2 = box
    part = labels[y1:y2, x1:x2] == index
    columns = np.flatnonzero(part.sum(axis=0) >= THIN * (y2 - y1))
    if not columns.size:
        return x1, y1, x2, y2
    left, right = int(columns[0]), int(columns[-1]) + 1
    rows = np.flatnonzero(part[:, left:right].any(axis=1))
    return x1 + left, y1 + int(rows[0]), x1 + right, y1 + int(rows[-1]) + 1


def fit_height_profile(blobs: Sequence[Blobs]) -> HeightProfile | None:
    """Fit the profile on which most isolated silhouettes of one camera agree.

    Args:
        blobs: silhouettes of several pictures, in reduced pixels.

    Returns:
        The profile, or None if too few silhouettes agree on one.
    """
    boxes = np.concatenate([b.box[b.alone()] for b in blobs] or [np.zeros((0, 4))])
    if len(boxes) < LEAST_SILHOUETTES:
        return None
    u, v = (boxes[:, 0] + boxes[:, 2]) / 2, boxes[:, 3].astype(np.float64)
    height = v - boxes[:, 1]
    design = np.stack([v, u, np.ones(len(u))], axis=-1)
    best = np.zeros(len(u), bool)
    random = np.random.default_rng(0)
    for _ in range(TRIALS):
        rows = random.choice(len(u), 3, replace=False)
        # Least squares, because three silhouettes on a line leave the plane undetermined.
        best = max(best, _agreeing(design, height, rows), key=np.count_nonzero)
    for _ in range(5):
        best = _agreeing(design, height, np.flatnonzero(best)) if best.sum() >= 3 else best
    if best.sum() < max(LEAST_SILHOUETTES, 0.3 * len(u)):
        return None
    return HeightProfile(np.linalg.lstsq(design[best], height[best], rcond=None)[0])


def _agreeing(design: Float[np.ndarray, "n 3"], height: Any, rows: Any) -> Bool[np.ndarray, " n"]:
    """Mark the silhouettes near the profile through some of them."""
    fit = np.linalg.lstsq(design[rows], height[rows], rcond=1e-6)[0]
    expected = design @ fit
    return (expected > 0) & (np.abs(height - expected) < TOLERANCE * np.maximum(expected, 1))
