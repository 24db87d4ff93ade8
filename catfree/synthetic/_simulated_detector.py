"""A simulated person detector with pose and appearance: misses, cut boxes, false positives, noise.

No constant here was chosen to favor a method; each states what it imitates.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import expit, ndtr

from catfree.synthetic._silhouettes import ROWS, Silhouettes, cast_silhouettes
from catfree.synthetic._walkers import Walkers, seeded
from catfree.types import Detections, Rig
from catfree.types._validation import require_instance

FALSE_POSITIVE = -1  # identity of a detection that shows no person
SMALLEST_BOX = 8.0  # pixels of height; detectors report nothing smaller
STATIC_SHARE = 0.5  # of the false positives stay in one place (signs, bins, reflections)
STATIC_PLACES = 3  # such places per camera


@dataclass(frozen=True)
class DetectorModel:
    """Quality of the simulated detector, pose estimator and appearance network.

    Attributes:
        detection_rate: probability of detecting a person who is large and fully visible.
        half_visible: visible share of the body at which that probability is halved.
        half_height: box height in pixels at which that probability is halved.
        persistence: seconds over which a miss or a detection persists.
        box_noise: standard deviation of each box side as a share of the box height.
        pixel_noise: standard deviation in pixels, added to `box_noise`.
        truncation: probability that a box with hidden feet ends at the lowest visible row; in the
            other boxes the feet are guessed with an error of `guess_noise` box heights.
        guess_noise: see `truncation`.
        false_positives: mean number per camera and frame.
        ankle_rate: probability that two visible ankles are confirmed.
        false_ankle_rate: probability that hidden ankles are confirmed.
        embedding_size: D, or 0 for none.
        common, identity, view, camera, noise: variances of the five parts of an embedding: shared
            by all people, of the person, of the person in this camera, of the camera, and of the
            single detection. The expected cosine distance between detections of one person is
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
    """Simulate the detections of a crowd in every camera and frame.

    Args:
        walkers: the people.
        rig: the true cameras in meters, z up.
        model: quality of the detector, or None for the default.
        columns: (K, 4) x, y, radius and height in meters of static occluders, or None.
        seed: determines all random draws.

    Returns:
        Detections sorted by frame, then camera, and (N,) the person in each, -1 for no person.

    Raises:
        InvalidInputError: if the model is not a `DetectorModel`.
    """
    model = DetectorModel() if model is None else model
    require_instance(model, DetectorModel, "model")
    rng = seeded(seed, 3)
    bodies = cast_silhouettes(walkers, rig, columns)
    detected = _draw_detected(rng, bodies, walkers, rig.camera_count, model)
    visible, person = bodies.visible[detected], bodies.person[detected]
    camera, frame = bodies.camera[detected], bodies.frame[detected]
    box, feet_seen = _noisy_boxes(rng, bodies.box[detected], visible, model)
    ankle_rate = np.where(feet_seen, model.ankle_rate, model.false_ankle_rate)
    ankles = rng.uniform(size=len(box)) < ankle_rate
    score = np.clip(0.3 + 0.6 * visible.mean(-1) + rng.normal(0, 0.08, len(box)), 0.05, 0.98)

    false_frame, false_camera, false_box = _false_positives(rng, walkers, rig, box, model)
    count = len(false_box)
    arrays = {
        "frame": np.concatenate([frame, false_frame]),
        "camera": np.concatenate([camera, false_camera]),
        "box": np.concatenate([box, false_box]),
        "score": np.concatenate([score, rng.uniform(0.1, 0.6, count)]),
        "ankles_confirmed": np.concatenate([ankles, rng.uniform(size=count) < 0.2]),
    }
    identity = np.concatenate([person, np.full(count, FALSE_POSITIVE)])
    if model.embedding_size:
        occluder = np.concatenate([bodies.hidden_by[detected], np.full(count, FALSE_POSITIVE)])
        share = np.concatenate([1 - visible.mean(-1), np.zeros(count)])
        arrays["embedding"] = _embeddings(
            rng, identity, occluder, share, arrays["camera"], len(walkers.height), rig, model
        )
    sizes = np.asarray(rig.image_size)[arrays["camera"]]
    arrays["box"], kept = _inside_image(arrays["box"], sizes)
    order = np.flatnonzero(kept)
    order = order[np.lexsort((arrays["camera"][order], arrays["frame"][order]))]
    return Detections(**{name: value[order] for name, value in arrays.items()}), identity[order]


def _draw_detected(
    rng: np.random.Generator,
    bodies: Silhouettes,
    walkers: Walkers,
    cameras: int,
    model: DetectorModel,
) -> Bool[np.ndarray, " m"]:
    """Draw the detected bodies: likelier if visible and large, and correlated in time."""
    height = bodies.box[:, 3] - bodies.box[:, 1]
    visible = bodies.visible.mean(-1)
    rate = (
        model.detection_rate
        * expit((visible - model.half_visible) / 0.06)
        * expit((height - model.half_height) / 6.0)
    )
    # A first-order process in time with standard normal marginals, one per person and camera.
    memory = np.exp(-1 / (walkers.fps * model.persistence)) if model.persistence > 0 else 0.0
    frames, people = walkers.present.shape
    order = np.argsort(bodies.frame, kind="stable")
    ends = np.cumsum(np.bincount(bodies.frame, minlength=frames))
    luck, state = np.empty(len(rate)), np.zeros((people, cameras))
    for frame, rows in enumerate(np.split(order, ends[:-1])):  # all frames at once would be large
        spread = np.sqrt(1 - memory**2) if frame else 1.0
        state = memory * state + spread * rng.standard_normal(state.shape)
        luck[rows] = state[bodies.person[rows], bodies.camera[rows]]
    return ndtr(luck) < rate


def _noisy_boxes(
    rng: np.random.Generator,
    box: Float[np.ndarray, "n 4"],
    visible: Float[np.ndarray, "n row"],
    model: DetectorModel,
) -> tuple[Float[np.ndarray, "n 4"], Bool[np.ndarray, " n"]]:
    """Boxes with noise and hidden feet, and whether the feet are visible."""
    height = box[:, 3] - box[:, 1]
    feet_seen = visible[:, -2:].min(-1) >= 0.5
    row_visible = visible >= 0.5
    lowest = np.where(row_visible.any(-1), ROWS - np.argmax(row_visible[:, ::-1], -1), ROWS)
    # No box is cut above the waist: detectors do not take such stumps for people.
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
    """Clip boxes at the image border, and mark those that are still large enough."""
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
    """Draw false boxes of person size: some at fixed places per camera, some anywhere."""
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
    occluder: Int[np.ndarray, " n"],
    hidden: Float[np.ndarray, " n"],
    camera: Int[np.ndarray, " n"],
    people: int,
    rig: Rig,
    model: DetectorModel,
) -> Float[np.ndarray, "n d"]:
    """Draw appearance, stable in time, weaker across views and mixed with the occluder's.

    In single precision, as from networks.
    """
    size, cameras = model.embedding_size, rig.camera_count

    def part(variance: float, *shape: int) -> np.ndarray:
        return np.sqrt(variance) * rng.standard_normal((*shape, size))

    common = part(model.common)
    person = part(model.identity, people)
    as_seen = part(model.view, cameras, people)
    colors = part(model.camera, cameras)
    look = person[None] + as_seen
    real = identity >= 0
    vector = look[camera, np.where(real, identity, 0)]
    # False positives resemble nothing else: each is a new "person".
    vector[~real] = part(model.identity + model.view, len(identity))[~real]
    share = np.where(occluder >= 0, np.clip(hidden, 0, 0.6), 0.0)[:, None]
    vector *= 1 - share
    vector += share * look[camera, np.maximum(occluder, 0)]
    for more in (common, colors[camera], part(model.noise, len(identity))):
        vector += more
    vector /= np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector.astype(np.float32)
