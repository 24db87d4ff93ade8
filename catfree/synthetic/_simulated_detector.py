"""A simulated person detector with pose and appearance: it misses, truncates, imagines and errs.

No constant here was set to make a method look good or bad; each says what it imitates.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.signal import lfilter
from scipy.special import expit, ndtr

from catfree.synthetic._silhouettes import ROWS, Silhouettes, observe
from catfree.synthetic._walkers import Walkers
from catfree.types import Detections, Rig

FALSE_POSITIVE = -1  # identity of a detection that is nobody
SMALLEST_BOX = 8.0  # pixels of height; detectors report nothing smaller
STATIC_SHARE = 0.5  # of the false positives stay at one place (signs, bins, reflections)
STATIC_PLACES = 3  # such places a camera


@dataclass(frozen=True)
class DetectorModel:
    """How good the simulated detector, pose estimator and appearance network are.

    Attributes:
        detection_rate: probability to find a person who is large and fully visible.
        half_visible: visible share of the body at which that probability is halved.
        half_height: box height in pixels at which that probability is halved.
        persistence: seconds over which a miss or a find persists.
        box_noise: standard deviation of each box side as a share of the box height.
        pixel_noise: standard deviation in pixels that adds to it.
        truncation: probability that a box with hidden feet ends at the lowest visible row; the
            others are guessed, with a foot error of `guess_noise` box heights.
        guess_noise: see `truncation`.
        false_positives: mean number a camera and frame.
        ankle_rate: probability that two visible ankles are confirmed.
        false_ankle_rate: probability that hidden ones are.
        embedding_size: D, or 0 for none.
        common, identity, view, camera, noise: variances of the five parts of an embedding: shared
            by all people, the person's own, the person as this camera sees them, the camera's
            colours, and each detection's own. The expected cosine distance within a person is
            noise / total in one camera and (view + camera + noise) / total between cameras.
    """

    detection_rate: float | int = 0.97
    half_visible: float | int = 0.3
    half_height: float | int = 35.0
    persistence: float | int = 0.5
    box_noise: float | int = 0.012
    pixel_noise: float | int = 1.0
    truncation: float | int = 0.6
    guess_noise: float | int = 0.06
    false_positives: float | int = 0.6
    ankle_rate: float | int = 0.95
    false_ankle_rate: float | int = 0.1
    embedding_size: int = 64
    common: float | int = 0.3
    identity: float | int = 0.3
    view: float | int = 0.2
    camera: float | int = 0.1
    noise: float | int = 0.1


def detect(
    walkers: Walkers,
    rig: Rig,
    *,
    model: DetectorModel | None = None,
    columns: Float[np.ndarray, "k 4"] | None = None,
    seed: int = 0,
) -> tuple[Detections, Int[np.ndarray, " n"]]:
    """What a detector reports of a crowd in every camera and frame.

    Args:
        walkers: the people.
        rig: the true cameras in metres, z up.
        model: quality of the detector, or None for the default.
        columns: (K, 4) x, y, radius and height in metres of static occluders, or None.
        seed: everything random follows from it.

    Returns:
        Detections sorted by frame, then camera, and (N,) whom each shows, -1 for nobody.
    """
    model = DetectorModel() if model is None else model
    rng = np.random.default_rng([seed, 3])
    seen = observe(walkers, rig, columns)
    found = _found(rng, seen, walkers, rig.camera_count, model)
    visible = seen.visible[found]
    person, camera, frame = seen.person[found], seen.camera[found], seen.frame[found]
    box, feet_seen = _noisy_boxes(rng, seen.box[found], visible, model)
    ankle_rate = np.where(feet_seen, model.ankle_rate, model.false_ankle_rate)
    ankles = rng.uniform(size=len(box)) < ankle_rate
    score = np.clip(0.3 + 0.6 * visible.mean(-1) + rng.normal(0, 0.08, len(box)), 0.05, 0.98)

    false_frame, false_camera, false_box = _false_positives(rng, walkers, rig, box, model)
    count = len(false_box)
    everything = {
        "frame": np.concatenate([frame, false_frame]),
        "camera": np.concatenate([camera, false_camera]),
        "box": np.concatenate([box, false_box]),
        "score": np.concatenate([score, rng.uniform(0.1, 0.6, count)]),
        "ankles_confirmed": np.concatenate([ankles, rng.uniform(size=count) < 0.2]),
    }
    identity = np.concatenate([person, np.full(count, FALSE_POSITIVE)])
    if model.embedding_size:
        hider = np.concatenate([seen.hidden_by[found], np.full(count, FALSE_POSITIVE)])
        share = np.concatenate([1 - visible.mean(-1), np.zeros(count)])
        everything["embedding"] = _embeddings(
            rng, identity, hider, share, everything["camera"], len(walkers.height), rig, model
        )
    sizes = np.asarray(rig.image_size)[everything["camera"]]
    everything["box"], kept = _inside_image(everything["box"], sizes)
    order = np.flatnonzero(kept)
    order = order[np.lexsort((everything["camera"][order], everything["frame"][order]))]
    return Detections(**{name: value[order] for name, value in everything.items()}), identity[order]


def _found(
    rng: np.random.Generator,
    seen: Silhouettes,
    walkers: Walkers,
    cameras: int,
    model: DetectorModel,
) -> Bool[np.ndarray, " m"]:
    """Whom the detector finds: likelier when visible and large, and alike for a while."""
    height = seen.box[:, 3] - seen.box[:, 1]
    visible = seen.visible.mean(-1)
    rate = (
        model.detection_rate
        * expit((visible - model.half_visible) / 0.06)
        * expit((height - model.half_height) / 6.0)
    )
    # A luck of standard normal margin that is a first-order process in time, a person and camera.
    memory = np.exp(-1 / (walkers.fps * model.persistence)) if model.persistence > 0 else 0.0
    frames, people = walkers.present.shape
    drive = rng.standard_normal((frames, people, cameras))
    drive[1:] *= np.sqrt(1 - memory**2)
    luck = ndtr(lfilter([1.0], [1.0, -memory], drive, axis=0))
    return luck[seen.frame, seen.person, seen.camera] < rate


def _noisy_boxes(
    rng: np.random.Generator,
    box: Float[np.ndarray, "n 4"],
    visible: Float[np.ndarray, "n row"],
    model: DetectorModel,
) -> tuple[Float[np.ndarray, "n 4"], Bool[np.ndarray, " n"]]:
    """Boxes as reported, and whether the feet were seen."""
    height = box[:, 3] - box[:, 1]
    feet_seen = visible[:, -2:].min(-1) >= 0.5
    shown = visible >= 0.5
    lowest = np.where(shown.any(-1), ROWS - np.argmax(shown[:, ::-1], -1), ROWS)
    # Nobody is cut above the waist: such stumps are not taken for people.
    cut = box[:, 1] + height * np.maximum(lowest, ROWS // 2) / ROWS
    guess = box[:, 3] + model.guess_noise * height * rng.standard_normal(len(box))
    truncated = rng.uniform(size=len(box)) < model.truncation
    hidden_bottom = np.where(truncated, cut, guess)
    noisy = box.copy()
    noisy[:, 3] = np.where(feet_seen, box[:, 3], hidden_bottom)
    spread = model.box_noise * height + model.pixel_noise
    return noisy + spread[:, None] * rng.standard_normal(box.shape), feet_seen


def _inside_image(
    box: Float[np.ndarray, "n 4"], size: Int[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 4"], Bool[np.ndarray, " n"]]:
    """Boxes clipped at the image border, and which of them are left with a height and width."""
    limit = np.concatenate([size - 1, size - 1], -1)
    clipped: np.ndarray = np.clip(box, 0, limit)
    wide = clipped[:, 2] - clipped[:, 0] > SMALLEST_BOX / 4
    tall = clipped[:, 3] - clipped[:, 1] > SMALLEST_BOX
    return clipped, wide & tall


def _false_positives(
    rng: np.random.Generator,
    walkers: Walkers,
    rig: Rig,
    box: Float[np.ndarray, "n 4"],
    model: DetectorModel,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes of nobody: some at fixed places of a camera, some anywhere, sized like people."""
    frames, cameras = len(walkers.present), rig.camera_count
    empty = np.zeros(0, int), np.zeros(0, int), np.zeros((0, 4))
    if not len(box) or model.false_positives <= 0:
        return empty
    size = np.asarray(rig.image_size)
    middle = (box[:, :2] + box[:, 2:]) / 2
    low, high = np.quantile(middle[:, 1] / size[:, 1].max(), [0.02, 0.98])
    template = box[:, 2:] - box[:, :2]

    def place(camera: np.ndarray) -> np.ndarray:
        share = np.stack([rng.uniform(size=len(camera)), rng.uniform(low, high, len(camera))], -1)
        extent = template[rng.integers(len(template), size=len(camera))]
        extent = extent * rng.lognormal(0, 0.25, (len(camera), 1))
        center = share * size[camera]
        return np.concatenate([center - extent / 2, center + extent / 2], -1)

    spots = place(np.repeat(np.arange(cameras), STATIC_PLACES)).reshape(cameras, STATIC_PLACES, 4)
    rate = STATIC_SHARE * model.false_positives / STATIC_PLACES
    fires = rng.uniform(size=(frames, cameras, STATIC_PLACES)) < rate
    spot_frame, spot_camera, spot = np.nonzero(fires)
    static = spots[spot_camera, spot]
    static = static + rng.normal(0, 2, static.shape)
    number = rng.poisson((1 - STATIC_SHARE) * model.false_positives, (frames, cameras)).ravel()
    frame, camera = np.divmod(np.repeat(np.arange(frames * cameras), number), cameras)
    return (
        np.concatenate([spot_frame, frame]),
        np.concatenate([spot_camera, camera]),
        np.concatenate([static, place(camera)]),
    )


def _embeddings(
    rng: np.random.Generator,
    identity: Int[np.ndarray, " n"],
    hider: Int[np.ndarray, " n"],
    hidden: Float[np.ndarray, " n"],
    camera: Int[np.ndarray, " n"],
    people: int,
    rig: Rig,
    model: DetectorModel,
) -> Float[np.ndarray, "n d"]:
    """Appearance that is strong in time and weak across views; who hides somebody blends in."""
    size, cameras = model.embedding_size, rig.camera_count

    def part(variance: float, *shape: int) -> np.ndarray:
        return np.sqrt(variance) * rng.standard_normal((*shape, size))

    common = part(model.common)
    person = part(model.identity, people)
    as_seen = part(model.view, cameras, people)
    colours = part(model.camera, cameras)
    look = person[None] + as_seen
    real = identity >= 0
    own = look[camera, np.where(real, identity, 0)]
    # False positives look like nothing else: a new "person" each.
    own = np.where(real[:, None], own, part(model.identity + model.view, len(identity)))
    share = np.where(hider >= 0, np.clip(hidden, 0, 0.6), 0.0)[:, None]
    mixed = (1 - share) * own + share * look[camera, np.maximum(hider, 0)]
    vector = common + mixed + colours[camera] + part(model.noise, len(identity))
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)
