"""Model of a static camera's empty scene, and detection of foreground without shadows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from catfree.adapters.protocols import Image
from catfree.errors import InsufficientDataError, InvalidInputError

# Pictures are reduced by a whole factor to about this height: enough to locate the foot of a person
# of 100 pixels to a hundredth of the height, while noise and work shrink with the factor's square.
WORKING_HEIGHT = 360
# With fewer pictures a walker covers the background in half of them.
MINIMUM_SAMPLES = 8
MAXIMUM_SAMPLES = 64
# A pixel differs at 4.5 standard deviations of the noise (by chance a few pixels per picture, which
# the despeckling removes) and differs strongly at twice as much.
WEAK_DEVIATIONS = 4.5
STRONG_DEVIATIONS = 2 * WEAK_DEVIATIONS
SMALLEST_NOISE = 1.0  # gray values: rounding and compression leave at least this much
NOISE_WINDOW = 7  # pixels over which the noise is uniform
# Cast shadows keep between a third and nearly all of the light, equally in all channels, and keep
# the ground's texture: the ratio of the picture to the background is smooth.
DARKEST_SHADOW = float(np.log(0.3))
# Their darkness is learned. It is uniform over a scene, because the sky's light remains: levels at
# least a tenth as common as the most common one are shadows. Anything darker is gray clothing.
LEVELS = 30  # of the logarithm of the light, between the darkest possible shadow and none
COMMON_LEVEL = 0.1
LEVEL_MARGIN = 0.08  # grain and coding, in the logarithm
SHADOW_SAMPLES = 16  # pictures
SHADOW_WINDOW = 5  # pixels
SHADOW_COLOR = 0.12  # largest difference of a channel's log ratio from their mean
SHADOW_TEXTURE = 0.12  # largest spread of the log ratio beyond that of the noise
SHADOW_EDGE = 4  # pixels over which a shadow fades out, its blur by optics and coding included
CONTACT_GAP = 3  # pixels of mixed color between a body part and its support
RESTING_SHARE = 0.5  # of a part's columns, to count as clothes or hair


@dataclass(frozen=True)
class Foreground:
    """Pixels that differ from the background of a reduced picture.

    Attributes:
        mask: (h, w) 1 where something other than a shadow covers the background.
        difference: (h, w) largest difference of a channel in gray values, 0 outside the mask.
    """

    mask: UInt8[np.ndarray, "h w"]
    difference: Float[np.ndarray, "h w"]


def reduce_picture(image: Image, factor: int) -> Image:
    """Average each factor x factor pixels of a picture; an incomplete edge is left out."""
    import cv2

    if factor == 1:
        return image
    height, width = (side // factor for side in image.shape[:2])
    whole = image[: height * factor, : width * factor]
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)


class PictureSamples:
    """At most `MAXIMUM_SAMPLES` pictures, evenly spread over a stream of unknown length.

    They are reduced by the whole `factor` that brings the shorter side of the first near the
    working height.
    """

    def __init__(self) -> None:
        """Start empty."""
        self.pictures: list[Image] = []
        self._stride, self.seen, self.factor = 1, 0, 1

    def add(self, picture: Image) -> None:
        """Take the next picture of the stream; whether it is kept depends only on its number.

        Raises:
            InvalidInputError: if its size differs from that of earlier pictures.
        """
        if not self.seen:
            self.factor = max(1, round(min(picture.shape[:2]) / WORKING_HEIGHT))
        reduced = reduce_picture(picture, self.factor)
        if self.pictures and reduced.shape != self.pictures[0].shape:
            raise InvalidInputError(
                f"Picture {self.seen} has another size than the first. A background belongs to "
                "one camera: use one detector per camera."
            )
        if self.seen % self._stride == 0:
            self.pictures.append(reduced)
            if len(self.pictures) > MAXIMUM_SAMPLES:
                self.pictures = self.pictures[::2]
                self._stride *= 2
        self.seen += 1


@dataclass(frozen=True)
class BackgroundModel:
    """The empty scene.

    Colors are kept in planes, one per channel: NumPy is slow along an axis of length three.

    Attributes:
        scene: (3, h, w) median color of each pixel.
        noise: (h, w) standard deviation of an unchanged pixel in gray values.
        darkest: logarithm of the share of the light that the darkest shadows leave.
    """

    scene: Float[np.ndarray, "3 h w"]
    noise: Float[np.ndarray, "h w"]
    darkest: float = DARKEST_SHADOW

    @classmethod
    def estimate(cls, pictures: Sequence[Image]) -> "BackgroundModel":
        """Learn the model as the per-pixel median of pictures of one camera.

        Raises:
            InsufficientDataError: if there are fewer than `MINIMUM_SAMPLES`.
        """
        if len(pictures) < MINIMUM_SAMPLES:
            raise InsufficientDataError(
                f"A background needs at least {MINIMUM_SAMPLES} pictures of the static camera, got "
                f"{len(pictures)}. Use longer footage, a smaller stride, or a detector that needs "
                "no background."
            )
        scene, noise = zip(*(_learn_channel(pictures, c) for c in range(3)), strict=True)
        model = cls(np.stack(scene).astype(np.float32), _pool_noise(noise))
        step = -(-len(pictures) // SHADOW_SAMPLES)
        return replace(model, darkest=model._learn_darkest(pictures[::step]))

    def compare(self, picture: Image) -> Foreground:
        """Find the foreground in a picture of the same camera."""
        import cv2

        if picture.shape[:2] != self.noise.shape:
            raise InvalidInputError(
                f"The picture is {picture.shape[1]} x {picture.shape[0]} reduced pixels, but the "
                f"background is {self.noise.shape[1]} x {self.noise.shape[0]}: use one detector "
                "per camera."
            )
        gain = self._gain(picture)
        difference, weak = self._differ(picture, gain)
        lit = weak & ~self._shadow(picture, gain, weak)
        mask = np.asarray(cv2.medianBlur(lit.view(np.uint8), 3), np.uint8)
        sure = _touching(mask, (difference > STRONG_DEVIATIONS * self.noise) & (mask > 0))
        return Foreground(sure, difference * sure)

    def _learn_darkest(self, pictures: Sequence[Image]) -> float:
        """Find the darkest of the common shadow levels, with a margin."""
        edges = np.linspace(DARKEST_SHADOW, 0, LEVELS + 1)
        counts = np.zeros(LEVELS, np.int64)
        for picture in pictures:
            gain = self._gain(picture)
            shadow = self._shadow(picture, gain, self._differ(picture, gain)[1])
            light = _mean(self._log_light(picture, gain, np.flatnonzero(shadow)))
            counts += np.histogram(light, edges)[0]
        if not counts.any():
            return DARKEST_SHADOW
        common = np.flatnonzero(counts >= COMMON_LEVEL * counts.max())
        return max(float(edges[common[0]]) - LEVEL_MARGIN, DARKEST_SHADOW)

    def _gain(self, picture: Image) -> Float[np.ndarray, "3"]:
        """Estimate the change of gain and white balance as the median ratio of each channel."""
        observed = np.moveaxis(picture[::8, ::8], 2, 0).astype(np.float32)
        ratio = (observed + 1) / (self.scene[:, ::8, ::8] + 1)
        return np.median(ratio.reshape(3, -1), axis=1).astype(np.float32)

    def _differ(
        self, picture: Image, gain: Float[np.ndarray, "3"]
    ) -> tuple[Float[np.ndarray, "h w"], UInt8[np.ndarray, "h w"]]:
        """Return the largest difference of a channel, and 1 where it is significant."""
        import cv2

        difference = np.zeros(self.noise.shape, np.float32)
        for observed, scene, factor in zip(cv2.split(picture), self.scene, gain, strict=True):
            away = cv2.absdiff(observed.astype(np.float32), scene * factor)
            cv2.max(difference, away, dst=difference)
        return difference, (difference > WEAK_DEVIATIONS * self.noise).astype(np.uint8)

    def _log_light(
        self, picture: Image, gain: Float[np.ndarray, "3"], at: Int[np.ndarray, " n"]
    ) -> Float[np.ndarray, "3 n"]:
        """Compute the logarithm of the share of the light that is left at some pixels."""
        observed = _colors(picture, at)
        expected = self.scene.reshape(3, -1).take(at, axis=1) * gain[:, None]
        return np.log((observed + 1) / (expected + 1))

    def _shadow(
        self, picture: Image, gain: Float[np.ndarray, "3"], weak: UInt8[np.ndarray, "h w"]
    ) -> UInt8[np.ndarray, "h w"]:
        """Mark with 1 the pixels that show the background under less light.

        Few pixels of a picture differ from the background, so only those are examined.
        """
        import cv2

        at = np.flatnonzero(weak.view(bool))  # a view, because NumPy is slow at finding bytes
        near = np.flatnonzero(cv2.dilate(weak, np.ones((3, 3), np.uint8)).view(bool))
        ratio = self._log_light(picture, gain, near)
        color = np.stack([_averages(channel, near, weak.shape, 3).take(at) for channel in ratio])
        light = _mean(color)
        dimmed = np.abs(color - light).max(axis=0) < SHADOW_COLOR
        dimmed &= (light < 0) & (light > self.darkest)
        at = at[dimmed]
        # Spread over the dimmed pixels only: the lit ground and the shoe beside a shadow are not
        # part of it.
        gray = _mean(ratio.take(np.searchsorted(near, at), axis=1))
        share, mean, square = (
            _averages(values, at, weak.shape, SHADOW_WINDOW).take(at)
            for values in (np.ones_like(gray), gray, gray * gray)
        )
        mean /= share
        variance = square / share - mean * mean
        of_noise = (self.noise.ravel().take(at) / (_mean(_colors(picture, at)) + 1)) ** 2
        candidate, core = np.zeros_like(weak), np.zeros_like(weak)
        candidate.ravel()[at] = 1
        core.ravel()[at[variance < SHADOW_TEXTURE**2 + of_noise]] = 1
        edge = np.ones((2 * SHADOW_EDGE + 1, 2 * SHADOW_EDGE + 1), np.uint8)
        likely = candidate & cv2.dilate(core, edge)
        # The rim of a shadow is also dimmed ground, not a body that the shadow could rest on.
        return likely & ~_resting_on(likely, weak & ~candidate)


def _colors(picture: Image, at: Int[np.ndarray, " n"]) -> Float[np.ndarray, "3 n"]:
    """Return the colors of some pixels."""
    return picture.reshape(-1, 3).take(at, axis=0).T.astype(np.float32, order="C")


def _averages(
    values: Float[np.ndarray, " n"], at: Int[np.ndarray, " n"], shape: tuple[int, ...], window: int
) -> Float[np.ndarray, " pixel"]:
    """Average over the window around every pixel of a picture that is 0 except at some pixels."""
    import cv2

    plane = np.zeros(shape, np.float32)
    plane.ravel()[at] = values
    return cv2.blur(plane, (window, window)).ravel()


def _mean(color: Float[np.ndarray, "3 *pixel"]) -> Float[np.ndarray, "*pixel"]:
    return (color[0] + color[1] + color[2]) / np.float32(3)


def _resting_on(
    shadow: UInt8[np.ndarray, "h w"], body: UInt8[np.ndarray, "h w"]
) -> UInt8[np.ndarray, "h w"]:
    """Mark the parts of a shadow that rest on a body over most of their width: heads, gray clothes.

    A cast shadow lies on the ground and meets a body at one end.
    """
    import cv2

    count, labels = _number_parts(shadow)
    reach = np.zeros((2 * CONTACT_GAP + 1, 1), np.uint8)
    reach[CONTACT_GAP:] = 1  # looks downwards
    below = cv2.dilate(body, reach)
    contacts, width = (_count_columns(labels, count, where) for where in (below & shadow, shadow))
    resting = contacts >= RESTING_SHARE * np.maximum(width, 1)
    return resting.view(np.uint8).take(labels)


def _count_columns(
    labels: Int[np.ndarray, "h w"], count: int, where: UInt8[np.ndarray, "h w"]
) -> Int[np.ndarray, " part"]:
    """Count the columns in which each part has a marked pixel."""
    at = np.flatnonzero(where.view(bool))
    marked = np.zeros((count, labels.shape[1]), bool)
    marked[labels.ravel()[at], at % labels.shape[1]] = True
    return np.count_nonzero(marked, axis=1)


def _learn_channel(
    pictures: Sequence[Image], channel: int
) -> tuple[UInt8[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Compute the median of one channel and the mean square of the smaller half of the deviations.

    People and shadows cover a pixel in a minority of the pictures, so the smaller half of its
    deviations is pure noise.
    """
    # Partitioned along the last axis and in 16 bits, for which NumPy has vector instructions.
    samples = np.stack([picture[..., channel] for picture in pictures], axis=-1).astype(np.int16)
    middle = samples.shape[-1] // 2
    samples.partition(middle, axis=-1)
    scene = samples[..., middle].astype(np.uint8)
    deviation = np.abs(samples - scene[..., None])
    deviation.partition(middle, axis=-1)
    return scene, (deviation[..., :middle].astype(np.float32) ** 2).mean(axis=-1)


def _pool_noise(squares: Sequence[Float[np.ndarray, "h w"]]) -> Float[np.ndarray, "h w"]:
    """Compute the standard deviation of each pixel's unchanged values, over a small window."""
    import cv2

    deviation = sum(cv2.blur(square, (NOISE_WINDOW,) * 2) for square in squares)
    # The smaller half of a normal distribution's magnitudes has a mean square of 0.143 sigma².
    noise = np.maximum(np.sqrt(deviation / 3 / 0.143), SMALLEST_NOISE)
    # Where a crowd stays, even the smaller half is not only noise.
    return np.minimum(noise, 2 * np.median(noise))


def _touching(
    mask: UInt8[np.ndarray, "h w"], strong: Bool[np.ndarray, "h w"]
) -> UInt8[np.ndarray, "h w"]:
    """Keep the connected parts of a mask that contain a strong pixel."""
    count, labels = _number_parts(mask)
    kept = np.zeros(count, bool)
    kept[labels.ravel()[np.flatnonzero(strong)]] = True
    return kept.view(np.uint8).take(labels)


def _number_parts(mask: UInt8[np.ndarray, "h w"]) -> tuple[int, Int[np.ndarray, "h w"]]:
    """Count the connected parts of a mask, background included, and number each pixel's part."""
    import cv2

    count, labels = cv2.connectedComponents(mask, connectivity=8)
    return count, np.asarray(labels, np.int32)
