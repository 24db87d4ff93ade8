"""The empty scene of a static camera, and what differs from it in a picture, shadows excepted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from catfree.adapters.protocols import Image
from catfree.errors import InsufficientDataError, InvalidInputError

# With fewer pictures a walker covers his background in half of them.
MINIMUM_SAMPLES = 8
MAXIMUM_SAMPLES = 64
# A pixel differs at 4.5 standard deviations of the noise (a few pixels a picture by chance, which
# the despeckling removes) and differs strongly at twice as much.
WEAK_DEVIATIONS = 4.5
STRONG_DEVIATIONS = 2 * WEAK_DEVIATIONS
SMALLEST_NOISE = 1.0  # grey values: rounding and compression leave at least so much
NOISE_WINDOW = 7  # pixels over which the noise is alike
# Cast shadows keep between a third and nearly all of the light, alike in all channels, and keep
# the ground's texture: the ratio of the picture to the background is smooth.
DARKEST_SHADOW = float(np.log(0.3))
# How dark they are is the same all over a scene, since the sky's light stays, and is learnt: levels
# at least a tenth as common as the most common one are shadows. What is darker is grey clothes.
LEVELS = 30  # of the logarithm of the light, between the darkest possible shadow and none
COMMON_LEVEL = 0.1
LEVEL_MARGIN = 0.08  # grain and coding, in the logarithm
SHADOW_SAMPLES = 16  # pictures
SHADOW_WINDOW = 5  # pixels
SHADOW_COLOUR = 0.12  # largest difference of a channel's log ratio from their mean
SHADOW_TEXTURE = 0.12  # largest spread of the log ratio besides the noise's own
SHADOW_EDGE = 4  # pixels over which a shadow fades out, its blur by optics and coding included
CONTACT_GAP = 3  # pixels of mixed colour between a body part and what it rests on
RESTING_SHARE = 0.5  # of a part's columns, to be called clothes or hair


@dataclass(frozen=True)
class Foreground:
    """What differs from the background, in reduced pixels.

    Attributes:
        mask: (h, w) 1 where something else than a shadow stands before the background.
        difference: (h, w) largest difference of a channel in grey values, 0 outside the mask.
    """

    mask: UInt8[np.ndarray, "h w"]
    difference: Float[np.ndarray, "h w"]


class PictureSamples:
    """At most `MAXIMUM_SAMPLES` pictures, evenly spread over a stream of unknown length."""

    def __init__(self) -> None:
        """Start empty."""
        self.pictures: list[Image] = []
        self._stride, self._seen = 1, 0

    def add(self, picture: Image) -> None:
        """Take the next picture of the stream; whether it stays depends on its number alone.

        Raises:
            InvalidInputError: if it has another size than the pictures before it.
        """
        if self.pictures and picture.shape != self.pictures[0].shape:
            raise InvalidInputError(
                f"Picture {self._seen} has another size than the first. A background belongs to "
                "one camera: use one detector a camera."
            )
        if self._seen % self._stride == 0:
            self.pictures.append(picture)
            if len(self.pictures) > MAXIMUM_SAMPLES:
                self.pictures = self.pictures[::2]
                self._stride *= 2
        self._seen += 1


@dataclass(frozen=True)
class BackgroundModel:
    """The empty scene.

    Attributes:
        scene: (h, w, 3) median colour of each pixel.
        noise: (h, w) standard deviation of an unchanged pixel in grey values.
        darkest: logarithm of the share of the light that the darkest shadows leave.
    """

    scene: Float[np.ndarray, "h w 3"]
    noise: Float[np.ndarray, "h w"]
    darkest: float = DARKEST_SHADOW

    @classmethod
    def estimate(cls, pictures: Sequence[Image]) -> "BackgroundModel":
        """The per-pixel median of pictures of one camera.

        Raises:
            InsufficientDataError: if there are fewer than `MINIMUM_SAMPLES`.
        """
        if len(pictures) < MINIMUM_SAMPLES:
            raise InsufficientDataError(
                f"A background needs at least {MINIMUM_SAMPLES} pictures of the static camera, got "
                f"{len(pictures)}. Use longer footage, a smaller stride, or a detector that needs "
                "no background."
            )
        stack = np.stack(pictures)
        middle = len(stack) // 2
        scene = np.partition(stack, middle, axis=0)[middle]
        model = cls(scene.astype(np.float32), _noise(stack, scene))
        step = -(-len(stack) // SHADOW_SAMPLES)
        return replace(model, darkest=model._learn_darkest(pictures[::step]))

    def compare(self, picture: Image) -> Foreground:
        """What stands before the background in a picture of the same camera."""
        import cv2

        if picture.shape != self.scene.shape:
            raise InvalidInputError(
                f"The picture is {picture.shape[1]} x {picture.shape[0]} reduced pixels, but the "
                f"background {self.scene.shape[1]} x {self.scene.shape[0]}: one detector serves "
                "one camera."
            )
        seen = picture.astype(np.float32)
        expected = self.scene * self._exposure(seen)
        difference = _largest(np.abs(seen - expected))
        weak = (difference > WEAK_DEVIATIONS * self.noise).astype(np.uint8)
        lit = weak & ~self._shadow(seen, expected, weak)
        mask = np.asarray(cv2.medianBlur(lit, 3), np.uint8)
        sure = _touching(mask, (difference > STRONG_DEVIATIONS * self.noise) & (mask > 0))
        return Foreground(sure, difference * sure)

    def _learn_darkest(self, pictures: Sequence[Image]) -> float:
        """The darkest of the common shadow levels, with a margin."""
        edges = np.linspace(DARKEST_SHADOW, 0, LEVELS + 1)
        counts = np.zeros(LEVELS, np.int64)
        for picture in pictures:
            seen = picture.astype(np.float32)
            expected = self.scene * self._exposure(seen)
            weak = _largest(np.abs(seen - expected)) > WEAK_DEVIATIONS * self.noise
            shadow = self._shadow(seen, expected, weak.astype(np.uint8)) > 0
            light = _mean(np.log((seen + 1) / (expected + 1)))[shadow]
            counts += np.histogram(light, edges)[0]
        if not counts.any():
            return DARKEST_SHADOW
        common = np.flatnonzero(counts >= COMMON_LEVEL * counts.max())
        return max(float(edges[common[0]]) - LEVEL_MARGIN, DARKEST_SHADOW)

    def _exposure(self, seen: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "3"]:
        """Change of the camera's gain and white balance: the median ratio of each channel."""
        ratio = (seen[::8, ::8] + 1) / (self.scene[::8, ::8] + 1)
        return np.median(ratio.reshape(-1, 3), axis=0).astype(np.float32)

    def _shadow(
        self,
        seen: Float[np.ndarray, "h w 3"],
        expected: Float[np.ndarray, "h w 3"],
        weak: UInt8[np.ndarray, "h w"],
    ) -> UInt8[np.ndarray, "h w"]:
        """1 where the picture is the background under less light."""
        import cv2

        x, y, width, height = cv2.boundingRect(weak)
        shadow = np.zeros_like(weak)
        if width == 0:
            return shadow
        part = np.s_[y : y + height, x : x + width]
        ratio = np.log((seen[part] + 1) / (expected[part] + 1))
        colour = cv2.blur(ratio, (3, 3))
        light = _mean(colour)
        neutral = _largest(np.abs(colour - light[..., None])) < SHADOW_COLOUR
        candidate = weak[part] * (neutral & (light < 0) & (light > self.darkest))
        # Spread over the dimmed pixels alone: the lit ground and the shoe beside a shadow are no
        # part of it.
        dimmed = candidate.astype(np.float32)
        window = (SHADOW_WINDOW, SHADOW_WINDOW)
        share = np.maximum(cv2.blur(dimmed, window), 1e-6)
        grey = _mean(ratio)
        mean = cv2.blur(grey * dimmed, window) / share
        variance = cv2.blur(grey * grey * dimmed, window) / share - mean * mean
        own = (self.noise[part] / (_mean(seen[part]) + 1)) ** 2
        core = candidate * (variance < SHADOW_TEXTURE**2 + own)
        edge = np.ones((2 * SHADOW_EDGE + 1, 2 * SHADOW_EDGE + 1), np.uint8)
        likely = candidate * cv2.dilate(core, edge)
        # A shadow's own rim is dimmed ground too: it is no body that the shadow could rest on.
        shadow[part] = likely & ~_resting_on(likely, weak[part] & ~candidate)
        return shadow


# NumPy reduces an axis of length three slowly.
def _largest(colour: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
    return np.maximum(np.maximum(colour[..., 0], colour[..., 1]), colour[..., 2])


def _mean(colour: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
    return (colour[..., 0] + colour[..., 1] + colour[..., 2]) / np.float32(3)


def _resting_on(
    shadow: UInt8[np.ndarray, "h w"], body: UInt8[np.ndarray, "h w"]
) -> UInt8[np.ndarray, "h w"]:
    """The parts of a shadow that rest on a body over most of their width: heads and grey clothes.

    A cast shadow lies on the ground and meets a body at one end.
    """
    import cv2

    count, labels = _number_parts(shadow)
    reach = np.zeros((2 * CONTACT_GAP + 1, 1), np.uint8)
    reach[CONTACT_GAP:] = 1  # looks downwards
    below = cv2.dilate(body, reach)
    columns = shadow.shape[1]
    at = np.broadcast_to(np.arange(columns)[None, :], shadow.shape)
    touching = (below & shadow) > 0
    contacts, width = (
        np.bincount(np.unique(labels[where] * columns + at[where]) // columns, minlength=count)
        for where in (touching, shadow > 0)
    )
    resting = contacts >= RESTING_SHARE * np.maximum(width, 1)
    resting[0] = False
    return resting[labels].astype(np.uint8)


def _noise(
    stack: UInt8[np.ndarray, "n h w 3"], scene: UInt8[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w"]:
    """Standard deviation of each pixel's unchanged values, alike within a small window.

    People and shadows cover a pixel in the smaller part of the pictures; the smaller half of its
    deviations is noise alone.
    """
    import cv2

    half = len(stack) // 2
    deviation = np.zeros(scene.shape[:2], np.float32)
    for channel in range(3):
        values = stack[..., channel].astype(np.int16) - scene[None, ..., channel]
        smaller = np.partition(np.abs(values), half, axis=0)[:half]
        deviation += cv2.blur((smaller.astype(np.float32) ** 2).mean(axis=0), (NOISE_WINDOW,) * 2)
    # The smaller half of a normal distribution's magnitudes has a mean square of 0.143 sigma².
    noise = np.maximum(np.sqrt(deviation / 3 / 0.143), SMALLEST_NOISE)
    # Where a crowd stays, even the smaller half is not.
    return np.minimum(noise, 2 * np.median(noise))


def _touching(
    mask: UInt8[np.ndarray, "h w"], strong: Bool[np.ndarray, "h w"]
) -> UInt8[np.ndarray, "h w"]:
    """The connected parts of a mask that hold a strong pixel."""
    count, labels = _number_parts(mask)
    kept = np.zeros(count, np.uint8)
    kept[np.unique(labels[strong])] = 1
    kept[0] = 0
    return kept[labels]


def _number_parts(mask: UInt8[np.ndarray, "h w"]) -> tuple[int, Int[np.ndarray, "h w"]]:
    """How many connected parts a mask has, background included, and the number of each pixel."""
    import cv2

    count, labels = cv2.connectedComponents(mask, connectivity=8)
    return count, np.asarray(labels, np.int32)
