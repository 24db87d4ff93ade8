"""Appearance embedding by color histograms of body parts, without weights."""

from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from catfree.adapters.embedders._crops import clipped_crops, unit_rows
from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.protocols import Image, as_image

# Body parts in shares of the box's height: head, upper and lower trunk, legs. Soles and the ground
# around them are left out.
ZONES = ((0.02, 0.14), (0.16, 0.34), (0.34, 0.52), (0.54, 0.9))
# Heads are small and look similar; clothes distinguish people.
ZONE_WEIGHTS = (0.5, 1.0, 1.0, 1.0)
CROP_WIDTH, CROP_HEIGHT = 24, 64
# Columns are weighted by a bell curve, because the box's sides show the background.
COLUMN_SPREAD = 0.16  # of the box's width
HUES = 12
LIGHTNESS_LEVELS = 5
# Below this saturation the hue is noise; a pixel's vote is split between color and lightness.
GRAY_SATURATION = 0.2
_VERSION = 1


class ColorEmbedder:
    """Embedder by the colors of body parts; needs only OpenCV.

    Each of four zones of the box (head, upper and lower trunk, legs) gives a soft histogram: of hue
    for colored pixels, and of lightness relative to the person's mean for gray ones. Hue and
    relative lightness do not change with exposure; square roots of the bins make the inner product
    of two vectors the Bhattacharyya coefficient of their histograms.
    """

    @property
    def fingerprint(self) -> str:
        """Content hash of the parameters."""
        return hash_parameters("ColorEmbedder", version=_VERSION)

    def __call__(self, image: Image, box: Any) -> Float[np.ndarray, "n d"]:
        """Compute one unit vector per box (n, 4) xyxy in pixels of the picture."""
        crops = clipped_crops(as_image(image), box, (CROP_WIDTH, CROP_HEIGHT))
        stack = np.array(crops, np.uint8).reshape(-1, CROP_HEIGHT, CROP_WIDTH, 3)
        return unit_rows(_describe(stack).astype(np.float32))


def _describe(crops: UInt8[np.ndarray, "n h w 3"]) -> Float[np.ndarray, "n d"]:
    """Compute the square roots of the weighted histograms of all zones of each person."""
    import cv2

    channels = np.moveaxis(crops, -1, 0).astype(np.float32, order="C") / 255
    high, low = channels.max(axis=0), channels.min(axis=0)
    chroma = high - low
    saturation = chroma / np.maximum(high, 0.05)
    colored = saturation**2 / (saturation**2 + GRAY_SATURATION**2)
    pixels = np.moveaxis(channels, 0, -1).reshape(-1, CROP_WIDTH, 3)
    hsv = cv2.cvtColor(pixels, cv2.COLOR_RGB2HSV) if len(pixels) else pixels
    hue = hsv[..., 0].reshape(high.shape) / 360
    middle = (np.arange(CROP_WIDTH) + 0.5) / CROP_WIDTH - 0.5
    weight = np.exp(-0.5 * (middle / COLUMN_SPREAD) ** 2) * np.ones_like(high)
    # Exposure scales all pixels of a person equally, so lightness is relative to the mean.
    mean = np.average(high, axis=(1, 2), weights=weight, keepdims=True)
    mean = np.maximum(mean, 0.02).astype(np.float32)
    lightness = np.clip(0.5 + 0.25 * np.log2(np.maximum(high, 0.004) / mean), 0, 1)
    histograms = []
    for (top, bottom), share in zip(ZONES, ZONE_WEIGHTS, strict=True):
        rows = np.s_[:, round(top * CROP_HEIGHT) : round(bottom * CROP_HEIGHT)]
        color = _soft_histogram(hue[rows] * HUES, (weight * colored)[rows], HUES, circular=True)
        gray = _soft_histogram(
            lightness[rows] * (LIGHTNESS_LEVELS - 1),
            (weight * (1 - colored))[rows],
            LIGHTNESS_LEVELS,
            circular=False,
        )
        histogram = np.concatenate([color, gray], axis=1)
        histograms.append(np.sqrt(share * histogram / histogram.sum(axis=1, keepdims=True)))
    return np.concatenate(histograms, axis=1)


def _soft_histogram(
    bin_coordinate: Float[np.ndarray, "n h w"],
    weight: Float[np.ndarray, "n h w"],
    bins: int,
    *,
    circular: bool,
) -> Float[np.ndarray, "n b"]:
    """Compute histograms that split each vote between the two nearest bins, to vary smoothly."""
    lower = np.floor(bin_coordinate).astype(np.int64)
    upper_share = bin_coordinate - lower
    count = len(bin_coordinate)
    first = bins * np.arange(count)[:, None, None]
    votes = np.zeros(count * bins)
    for index, share in ((lower, 1 - upper_share), (lower + 1, upper_share)):
        wrapped = index % bins if circular else np.clip(index, 0, bins - 1)
        votes += np.bincount((first + wrapped).ravel(), (share * weight).ravel(), count * bins)
    return votes.reshape(count, bins)
