"""Detection of people in a static camera by background subtraction, without a network."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

from catfree.adapters.background._background_model import (
    MAXIMUM_SAMPLES,
    MINIMUM_SAMPLES,
    BackgroundModel,
    Foreground,
    PictureSamples,
    reduce_picture,
)
from catfree.adapters.background._blob_grouping import group_blobs
from catfree.adapters.background._blob_splitting import WIDTH, Expected, split_blob
from catfree.adapters.background._foreground_memory import ForegroundMemory
from catfree.adapters.background._height_profile import (
    TOLERANCE,
    WIDEST,
    Blobs,
    HeightProfile,
    fit_height_profile,
)
from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.protocols import FrameDetections, Image, as_image
from catfree.errors import InvalidInputError
from catfree.types._validation import as_number

STAND_ALONE_SCORE = 0.95
SPLIT_SCORE = 0.85
UNSPLIT_SCORE = 0.4
EDGE_REACH = 0.12  # of the expected height, around the expected crown and soles
# Hair, in expected heights: it may differ less from the background than face and shoulders do.
CROWN = 0.05
_VERSION = 5


class BackgroundDetector:
    """Detector for static cameras that needs only OpenCV, no weights.

    It learns the empty scene as the median of many pictures, marks what differs from it except cast
    shadows, and finds people in the silhouettes: an isolated silhouette is a person; a merged one
    is split with body templates, whose height at each foot pixel is learned from this camera's
    isolated silhouettes.

    On recorded video, `fit(images)` reads a camera's footage once and returns the detector for that
    camera. Called directly, it is a detector for one camera's live pictures, in order: it learns
    from the pictures so far and returns no people until it has eight. Unlike other detectors, its
    result then depends on earlier pictures.

    Limitations: people who stand still for most of the footage become background, the camera must
    not move, and an object that was moved is reported until the median includes it.

    Attributes:
        box_slack: excess height of a box over the person, as a share of the box height. Silhouettes
            have none; detectors trained on drawn boxes have some, which calibration from people
            assumes for detectors without this attribute.
    """

    box_slack: float = 0.0

    def __init__(self, confidence: float | int = 0.30) -> None:
        """Choose the parameters.

        Args:
            confidence: weaker detections are dropped. About 0.9 means an isolated silhouette, 0.4
                to 0.85 one split from a group, 0.4 one of a camera with too few isolated people to
                learn their height.

        Raises:
            InvalidInputError: if the confidence is not in [0, 1].
        """
        self._confidence = as_number(confidence, "confidence")
        if not 0 <= self._confidence <= 1:
            raise InvalidInputError(f"confidence must lie in [0, 1], got {confidence}.")
        self._samples = PictureSamples()
        self._count_when_fitted = 0
        self._fitted: FittedBackgroundDetector | None = None

    @property
    def fingerprint(self) -> str:
        """Content hash of the parameters."""
        return hash_parameters("BackgroundDetector", version=_VERSION, confidence=self._confidence)

    def fit(self, images: Iterable[Image]) -> "FittedBackgroundDetector":
        """Fit a detector to the camera that took these pictures.

        Args:
            images: (H, W, 3) uint8 RGB of one static camera, read once and in order; at most 64
                reduced ones are kept in memory. They must span more than a few seconds, so that
                walkers do not cover the same ground in most of them.

        Raises:
            InsufficientDataError: if there are fewer than 8.
            InvalidInputError: if they differ in size.
        """
        samples = PictureSamples()
        for image in images:
            samples.add(as_image(image))
        return self._learn(samples)

    def __call__(self, image: Image) -> FrameDetections:
        """Detect the people in the next picture of one static camera."""
        picture = as_image(image)
        self._samples.add(picture)
        # Fit again each time the footage has doubled, later each time the sample is renewed.
        due_at = self._count_when_fitted + min(self._count_when_fitted, MAXIMUM_SAMPLES)
        if self._samples.seen >= max(due_at, MINIMUM_SAMPLES):
            # A live picture comes only once, so its foreground is not kept.
            self._fitted = replace(self._learn(self._samples), memory=None)
            self._count_when_fitted = self._samples.seen
        if self._fitted is None:
            return FrameDetections(np.zeros((0, 4), np.float32), np.zeros(0, np.float32))
        return self._fitted(picture)

    def _learn(self, samples: PictureSamples) -> "FittedBackgroundDetector":
        background = BackgroundModel.estimate(samples.pictures)
        memory = ForegroundMemory(background.compare)
        blobs = [Blobs.find(memory(picture).mask) for picture in samples.pictures]
        profile = fit_height_profile(blobs)
        fingerprint = hash_parameters(
            "FittedBackgroundDetector",
            self.fingerprint,
            hashlib.sha256(background.scene.tobytes()).hexdigest(),
            profile=None if profile is None else profile.coefficients.tolist(),
        )
        return FittedBackgroundDetector(
            background, profile, samples.factor, self._confidence, fingerprint, memory
        )


@dataclass(frozen=True)
class FittedBackgroundDetector:
    """Detector for the pictures of one static camera; made by `BackgroundDetector.fit`.

    Attributes:
        background: the empty scene, in reduced pixels.
        profile: apparent height of people in reduced pixels, or None if too few were isolated;
            only silhouettes with the shape of a person are then reported.
        factor: original pixels per reduced pixel.
        confidence: weaker detections are dropped.
        fingerprint: content hash of parameters and learned scene.
        memory: cache of foregrounds, or None to compute them each time.
    """

    background: BackgroundModel
    profile: HeightProfile | None
    factor: int
    confidence: float
    fingerprint: str
    memory: ForegroundMemory | None = field(default=None, repr=False, compare=False)

    def __call__(self, image: Image) -> FrameDetections:
        """Detect the people in one picture of this camera, best first."""
        return self.look_again(image, np.zeros((0, 3)))

    def look_again(self, image: Image, expected: Float[np.ndarray, "n 3"]) -> FrameDetections:
        """Detect people with hints about their positions from other cameras and frames.

        Merged silhouettes are split at expected people if their pixels support it, and parts of one
        person that a pole separates are joined. Only people that the silhouettes show are reported.

        Args:
            image: a picture of this camera.
            expected: (n, 3) foot column, foot row and height of people in pixels of the picture.
        """
        picture = as_image(image)
        compare = self.background.compare if self.memory is None else self.memory
        foreground = compare(reduce_picture(picture, self.factor))
        # The center of pixel p is at (p + 0.5) / factor from the reduced picture's left edge.
        corner = np.array([[0.5, 0.5, 0.0]])
        hints = (np.asarray(expected, np.float64) + corner) / self.factor
        people = self.find_people(foreground, [Expected(*hint) for hint in hints.tolist()])
        box = people[:, :4] * self.factor - 0.5  # a pixel extends half a pixel beyond its center
        limit = np.array([picture.shape[1], picture.shape[0]] * 2) - 0.5
        box = np.clip(box, -0.5, limit[None, :])
        keep = (people[:, 4] >= self.confidence) & (box[:, 2:] - box[:, :2] >= 1).all(axis=1)
        order = np.flatnonzero(keep)[np.argsort(-people[keep, 4], kind="stable")]
        return FrameDetections(box[order].astype(np.float32), people[order, 4].astype(np.float32))

    def find_people(
        self, foreground: Foreground, expected: Sequence[Expected]
    ) -> Float[np.ndarray, "n 5"]:
        """Find (n, 5) x1, y1, x2, y2 and score of people in a foreground, in reduced pixels."""
        blobs = Blobs.find(foreground.mask)
        if self.profile is None:
            alone = blobs.box[blobs.alone()]
            return np.column_stack([alone, np.full(len(alone), UNSPLIT_SCORE)]).astype(np.float64)
        rows = []
        for members, people in group_blobs(blobs.labels, len(blobs.box), expected):
            blob = blobs.mask_of(members)
            corners = blobs.box[members]
            box = np.concatenate([corners[:, :2].min(axis=0), corners[:, 2:].max(axis=0)])
            complete = bool(blobs.complete[members].all())
            rows.extend(_people_of(blob, box, complete, self.profile, foreground, people))
        return np.array(rows, np.float64).reshape(-1, 5)


def _people_of(
    blob: UInt8[np.ndarray, "h w"],
    box: Int[np.ndarray, "4"],
    complete: bool,
    profile: HeightProfile,
    foreground: Foreground,
    expected: Sequence[Expected],
) -> list[tuple[float, float, float, float, float]]:
    """Find box and score of each person in one blob."""
    x1, y1, x2, y2 = (float(side) for side in box)
    height = expected[0].height if len(expected) == 1 else float(profile((x1 + x2) / 2, y2))
    misfit = abs(y2 - y1 - height) / max(height, 1.0)
    alone = complete and misfit < TOLERANCE and x2 - x1 < WIDEST * height and len(expected) < 2
    people = []
    # Two people close together may have one person's height and width; a narrow blob holds one.
    if not alone or x2 - x1 > WIDTH * height:
        people = split_blob(blob, box, profile, expected)
    if alone and len(people) < 2:
        top, bottom = _extent(foreground, blob, (x1 + x2) / 2, (y1, y2))
        return [(x1, top, x2, bottom, STAND_ALONE_SCORE - 0.5 * misfit)]
    rows = []
    for person in people:
        top, bottom = _extent(foreground, blob, person.u, (person.v - person.height, person.v))
        half = WIDTH * person.height / 2
        score = min(SPLIT_SCORE, 0.2 + 0.7 * person.gain)
        rows.append((person.u - half, top, person.u + half, bottom, score))
    return rows


def _extent(
    foreground: Foreground,
    blob: UInt8[np.ndarray, "h w"],
    u: float,
    expected: tuple[float, float],
) -> tuple[float, float]:
    """Find the first and last row of a person, near the expected crown and soles.

    An edge blurred by optics and coding lies where the difference to the background falls to half
    its value inside the body. At the top, that value comes from the outermost rows, the hair; at
    the bottom from the legs, because the last rows may be only the rim of a shadow.
    """
    rows, columns = blob.shape
    height = expected[1] - expected[0]
    extent = list(expected)
    for end, (half_width, inner) in enumerate(((0.06, 1), (0.16, -1))):
        x1, x2 = (min(max(round(u + s * half_width * height), 0), columns) for s in (-1, 1))
        # From inside the body outwards.
        start = expected[end] + inner * EDGE_REACH * height
        count = max(2, round(2 * EDGE_REACH * height))
        line = np.rint(start - inner * np.arange(count)).astype(int).clip(0, rows - 1)
        if x1 >= x2:
            continue
        contrast = (foreground.difference[line, x1:x2] * blob[line, x1:x2]).max(axis=1)
        if not contrast.any():
            continue
        strength = contrast[: count // 2 + 1].max()
        outermost = int(np.flatnonzero(contrast)[-1])
        if end == 0 and outermost < count - 1:
            crown = max(2, round(CROWN * height))
            strength = contrast[max(0, outermost + 1 - crown) : outermost + 1].max()
        inside = np.flatnonzero(contrast >= 0.5 * strength)
        # Foreground that continues beyond the search range belongs to another person, too.
        if inside[-1] < count - 1:
            extent[end] = float(line[inside[-1]] + (1 if end else 0))
    return extent[0], extent[1]
