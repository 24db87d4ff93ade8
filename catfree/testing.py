"""Hypothesis strategies for property tests of code that works on multi-view scenes.

Properties of localization need no expected values: a similarity of the world transforms the result
and changes nothing else, the order of cameras has no effect, and exact boxes reproduce their
positions. These strategies draw worlds to test such properties. They shrink towards simple cases:
cameras evenly around the origin, people near it, the identity.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from catfree.errors import InvalidInputError, MissingDependencyError
from catfree.geometry import Similarity
from catfree.geometry._arrays import ArrayInput
from catfree.types import Detections, Plane, Rig, Scene

try:
    from hypothesis import strategies as st
except ImportError as error:
    raise MissingDependencyError(
        "catfree.testing draws its examples with hypothesis: pip install hypothesis."
    ) from error

if TYPE_CHECKING:
    from hypothesis.strategies import DrawFn

CAMERA_HEIGHT = (3.0, 6.0)  # meters
CAMERA_DISTANCE = (8.0, 15.0)  # meters from the origin, on the ground
PEOPLE_WITHIN = 3.0  # meters from the origin: inside every camera's picture
MOST_PEOPLE = 4  # one per quadrant
CLOSEST = 1.0  # meters between two people
BODY = (1.7, 0.5)  # height and width of a person in meters


class Observed(NamedTuple):
    """People and their exact boxes in all cameras of a scene, without occlusion.

    Attributes:
        scene: metric, z up, ground z = 0.
        positions: (P, 2) foot points in meters.
        detections: one box per person and camera in frame 0, with the foot point as bottom center,
            sorted by camera, then person.
    """

    scene: Scene
    positions: Float[np.ndarray, "p 2"]
    detections: Detections


def rotations() -> "st.SearchStrategy[np.ndarray]":
    """Draw rotations as quaternions.

    Returns:
        A strategy of (3, 3) float64 matrices that shrinks to the identity.
    """
    part = st.floats(-1, 1)
    return st.tuples(part, part, part).map(_rotation)


def similarities(
    scales: tuple[float, float] = (0.02, 50.0), reach: float | int = 100.0
) -> "st.SearchStrategy[Similarity]":
    """Draw similarity transforms of the world, without reflections.

    Args:
        scales: smallest and largest scale.
        reach: largest entry of the translation, in the units after scaling.

    Returns:
        A strategy of `cf.geometry.Similarity`.

    Raises:
        InvalidInputError: if the scales are not positive and ascending.
    """
    if not 0 < scales[0] <= scales[1] < np.inf:
        raise InvalidInputError(f"scales is {scales}; it must be two positive numbers in order.")
    entry = st.floats(-reach, reach)
    low, high = np.log(scales)
    scale = st.floats(low, high).map(lambda log: float(np.exp(log)))
    return st.builds(Similarity, scale, rotations(), st.tuples(entry, entry, entry).map(np.array))


@st.composite
def scenes(draw: "DrawFn", cameras: int | None = None) -> Scene:
    """Draw metric scenes with 2 to 6 cameras around the origin that see the people near it.

    Args:
        draw: provided by Hypothesis.
        cameras: number of cameras; None to draw it.

    Returns:
        A scene in meters, z up, ground z = 0, float64.
    """
    count = draw(st.integers(2, 6)) if cameras is None else cameras
    turn = draw(st.lists(st.floats(0, 0.4), min_size=count, max_size=count))
    distance = draw(st.lists(st.floats(*CAMERA_DISTANCE), min_size=count, max_size=count))
    height = draw(st.lists(st.floats(*CAMERA_HEIGHT), min_size=count, max_size=count))
    focal = draw(st.lists(st.floats(700, 1000), min_size=count, max_size=count))
    bearing = 2 * np.pi * (np.arange(count) + np.array(turn)) / count
    center = np.column_stack(
        [distance * np.cos(bearing), distance * np.sin(bearing), np.array(height)]
    )
    R = np.stack([_looking_at_origin(c) for c in center])
    K = np.array([[[f, 0, 959.5], [0, f, 539.5], [0, 0, 1]] for f in focal])
    rig = Rig(K, R, -np.einsum("cij,cj->ci", R, center), (1920, 1080))
    return Scene.from_rig(rig, Plane(np.array([0.0, 0.0, 1.0]), 0.0), metric=True)


@st.composite
def observed(draw: "DrawFn", cameras: int | None = None, people: int | None = None) -> Observed:
    """Draw a scene, 1 to 4 people at least 1 m apart, and their exact boxes.

    Args:
        draw: provided by Hypothesis.
        cameras: as in `scenes`.
        people: number of people, at most 4; None to draw it.

    Returns:
        Scene, positions and detections.

    Raises:
        InvalidInputError: if `people` is out of range.
    """
    count = draw(st.integers(1, MOST_PEOPLE)) if people is None else people
    if not 1 <= count <= MOST_PEOPLE:
        raise InvalidInputError(f"people is {people}; it must be 1 to {MOST_PEOPLE}.")
    scene = draw(scenes(cameras))
    offset = st.floats(CLOSEST / 2, PEOPLE_WITHIN / np.sqrt(2))
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])[:count]
    positions = signs * np.array([[draw(offset), draw(offset)] for _ in range(count)])
    return Observed(scene, positions, boxes_of(scene, positions))


def boxes_of(scene: Scene, positions: ArrayInput) -> Detections:
    """Compute exact boxes of upright people, 1.7 m tall, in all cameras in frame 0, unoccluded.

    Args:
        scene: in meters, z up, ground z = 0, without distortion.
        positions: (P, 2) foot points in meters, in front of every camera.

    Returns:
        C · P detections, sorted by camera, then person.
    """
    rig, ground = scene.rig, np.asarray(positions, np.float64).reshape(-1, 2)
    tall, wide = BODY
    ends = np.stack([np.column_stack([ground, np.full(len(ground), z)]) for z in (0.0, tall)])
    local = np.einsum("cij,epj->cepi", rig.R, ends) + np.asarray(rig.t)[:, None, None]
    image = np.einsum("cij,cepj->cepi", rig.K, local)
    foot, head = np.moveaxis(image[..., :2] / image[..., 2:], 1, 0)
    half = (foot[..., 1] - head[..., 1]) * wide / tall / 2
    box = np.stack([foot[..., 0] - half, head[..., 1], foot[..., 0] + half, foot[..., 1]], -1)
    camera = np.repeat(np.arange(rig.camera_count), len(ground))
    return Detections(np.zeros(len(camera), int), camera, box.reshape(-1, 4))


def _rotation(imaginary: tuple[float, float, float]) -> np.ndarray:
    """Compute the rotation of the quaternion 1 + xi + yj + zk."""
    return Rotation.from_quat([*imaginary, 1.0]).as_matrix()


def _looking_at_origin(center: np.ndarray) -> np.ndarray:
    """Compute the world-to-camera rotation with OpenCV axes; z is up in the world."""
    forward = -center / np.linalg.norm(center)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])
