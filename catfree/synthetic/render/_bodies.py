"""Walking bodies as meshes of swept tubes.

Lengths are shares of the body height, in body axes: x to the right, y ahead, z up. The ankles swing
as in `_silhouettes.body_points`, so boxes around drawn people agree with simulated boxes.
"""

import numpy as np
from jaxtyping import Float

from catfree.synthetic._silhouettes import FREE_SPEED, STRIDE_SHARE, swing_leg

SIDES = 10  # sides of a tube's cross-section
LEG_BONE = 0.234  # thigh and shank have the same length
UPPER_ARM, FOREARM = 0.165, 0.145
RIGHT, AHEAD, UP = np.eye(3)

# Parts with their own color.
SHIRT, SLEEVE, FOREARM_PART, TROUSERS, SHANK_PART, SHOES, SKIN, HAIR, BAG = range(9)


# Per tube: the part of the segment after each ring.
_LEG = (TROUSERS, TROUSERS, SHANK_PART, SHANK_PART)
_SHOE = (SHOES,) * 4
_TORSO = (TROUSERS, TROUSERS, SHIRT, SHIRT, SHIRT, SHIRT)
_HEAD = (SKIN,) * 6
_ARM = (SLEEVE, SLEEVE, FOREARM_PART, SKIN, SKIN)
_TUBES = (_LEG, _LEG, _SHOE, _SHOE, _TORSO, _HEAD, _ARM, _ARM, (BAG,) * 4)


def _join_tubes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    faces, parts, tubes, start = [], [], [], 0
    side = np.arange(SIDES)
    following = (side + 1) % SIDES
    # The face is on the sides that look ahead (+y); they show skin.
    front = np.sin((side + 0.5) * 2 * np.pi / SIDES) > 0.3
    for tube, segments in enumerate(_TUBES):
        for ring, part in enumerate(segments):
            low, high = start + ring * SIDES, start + (ring + 1) * SIDES
            faces.append(np.stack([low + side, low + following, high + following, high + side], -1))
            part_of_side = np.full(SIDES, part)
            if segments is _HEAD and ring >= 1:
                part_of_side = np.where(front & (ring < 4), SKIN, HAIR)
            parts.append(part_of_side)
        tubes.append(np.full((len(segments) + 1) * SIDES, tube))
        start += (len(segments) + 1) * SIDES
    return np.concatenate(faces), np.concatenate(parts), np.concatenate(tubes)


# The topology that all bodies share: (F, 4) vertices of each face, counter-clockwise from outside,
# and (F,) the part that colors it; (V,) the tube of each vertex. Each tube casts a convex shadow.
FACES, PART, TUBE = _join_tubes()


def body_vertices(
    stride: Float[np.ndarray, " n"], speed: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n v 3"]:
    """Compute vertices (N, V, 3) of N bodies in body axes and shares of the body height.

    Args:
        stride: (N,) phase of the walking cycle in radians.
        speed: (N,) in m/s; at 0 the legs are straight.
    """
    amount = np.clip(speed / FREE_SPEED, 0, 1)
    bob = -0.02 * amount * np.abs(np.sin(stride))
    legs, shoes, arms = [], [], []
    for side in (-1, 1):
        ahead, lift, heel = swing_leg(stride, amount, side)
        legs.append(_leg(side, ahead, 0.04 + lift + heel, bob))
        shoes.append(_shoe(side, ahead, lift, heel))
        arms.append(_arm(side, -0.48 * ahead / STRIDE_SHARE, bob))
    still = [_still(rings, bob) for rings in (_TORSO_RINGS, _HEAD_RINGS)]
    return np.concatenate([*legs, *shoes, *still, *arms, _still(_BAG_RINGS, bob)], 1)


# Rings of the rigid tubes: x, y, z of the middle, half width, half depth.
_TORSO_RINGS = np.array(
    [
        (0, 0, 0.45, 0.070, 0.055),
        (0, 0, 0.50, 0.092, 0.066),
        (0, 0, 0.56, 0.088, 0.060),
        (0, 0, 0.64, 0.086, 0.058),
        (0, 0.004, 0.74, 0.108, 0.066),
        (0, 0, 0.81, 0.112, 0.052),
        (0, 0, 0.845, 0.042, 0.036),
    ]
)
_HEAD_RINGS = np.array(
    [
        (0, 0, 0.83, 0.034, 0.034),
        (0, 0.006, 0.872, 0.034, 0.038),
        (0, 0.010, 0.89, 0.044, 0.052),
        (0, 0.006, 0.93, 0.051, 0.061),
        (0, 0, 0.965, 0.049, 0.058),
        (0, -0.002, 0.990, 0.032, 0.038),
        (0, -0.002, 1.0, 0.004, 0.004),
    ]
)
_BAG_RINGS = np.array(
    [
        (0, -0.09, 0.60, 0.02, 0.02),
        (0, -0.09, 0.62, 0.075, 0.045),
        (0, -0.09, 0.74, 0.078, 0.05),
        (0, -0.085, 0.80, 0.06, 0.035),
        (0, -0.085, 0.815, 0.01, 0.01),
    ]
)


def _still(rings: np.ndarray, bob: np.ndarray) -> np.ndarray:
    """Sweep a tube of horizontal rings that only bobs up and down."""
    center = np.broadcast_to(rings[:, :3], (len(bob), len(rings), 3)).copy()
    # The crown keeps its height, so that drawn people have their true height.
    center[..., 2] += bob[:, None] * np.clip((1.0 - rings[:, 2]) / 0.15, 0, 1)
    return _sweep(center, RIGHT, AHEAD, rings[:, 3:])


def _leg(side: int, ahead: np.ndarray, ankle: np.ndarray, bob: np.ndarray) -> np.ndarray:
    """Sweep a leg from hip to ankle in the plane of travel; the knee bends forward."""
    hip = np.stack([np.zeros_like(ahead), 0.507 + bob], -1)
    foot = np.stack([ahead, ankle], -1)
    knee = _knee(hip, foot)
    middle, calf = (hip + knee) / 2, knee + 0.3 * (foot - knee)
    path = np.stack([hip, middle, knee, calf, foot], 1)
    x = np.broadcast_to(side * np.array([0.048, 0.05, 0.052, 0.054, 0.055]), path.shape[:2])
    radius = np.array([0.052, 0.048, 0.035, 0.036, 0.024])
    return _sagittal(x, path, np.stack([radius, 1.1 * radius], -1))


def _shoe(side: int, ahead: np.ndarray, lift: np.ndarray, heel: np.ndarray) -> np.ndarray:
    """Sweep a shoe from heel to toe; the rear heel rises."""
    share = np.array([0.0, 0.1, 0.45, 0.85, 1.0])
    y = ahead[:, None] - 0.045 + 0.15 * share
    rise = np.array([0.024, 0.026, 0.026, 0.019, 0.016])
    z = lift[:, None] + heel[:, None] * np.clip(1 - share / 0.85, 0, 1) + rise
    radius = np.array([[0.008, 0.01], [0.024, 0.025], [0.026, 0.025], [0.025, 0.018], [0.01, 0.01]])
    center = np.stack([np.full_like(y, side * 0.055), y, z], -1)
    # Swept forward: right x up points backward, so the cross-section runs the other way.
    return _sweep(center, -RIGHT, UP, radius)


def _arm(side: int, angle: np.ndarray, bob: np.ndarray) -> np.ndarray:
    """Sweep an arm from shoulder to hand; the elbow bends more as the arm swings forward."""
    shoulder = np.stack([np.zeros_like(angle), 0.80 + bob], -1)
    upper = np.stack([np.sin(angle), -np.cos(angle)], -1)
    bent = angle + 0.25 + 0.35 * np.maximum(angle, 0)
    lower = np.stack([np.sin(bent), -np.cos(bent)], -1)
    elbow = shoulder + UPPER_ARM * upper
    wrist = elbow + FOREARM * lower
    path = np.stack(
        [
            shoulder - 0.005 * upper,
            shoulder + 0.1 * UPPER_ARM * upper,
            elbow,
            wrist,
            wrist + 0.035 * lower,
            wrist + 0.055 * lower,
        ],
        1,
    )
    x = np.broadcast_to(side * np.array([0.1, 0.124, 0.142, 0.146, 0.145, 0.143]), path.shape[:2])
    radius = np.array([0.022, 0.034, 0.027, 0.018, 0.022, 0.008])
    return _sagittal(x, path, np.stack([radius, radius], -1))


def _knee(hip: np.ndarray, foot: np.ndarray) -> np.ndarray:
    """Knee of a leg, bent forward; straight if the foot is out of reach."""
    reach = foot - hip
    length = np.clip(np.linalg.norm(reach, axis=-1, keepdims=True), 1e-6, None)
    bend = np.sqrt(np.maximum(LEG_BONE**2 - (length / 2) ** 2, 0))
    forward = np.stack([-reach[..., 1], reach[..., 0]], -1) / length
    return hip + reach / 2 + bend * forward


def _sagittal(x: np.ndarray, path: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Sweep a tube along a (y, z) path at sideways positions x, with rings square to the path."""
    center = np.concatenate([x[..., None], path], -1)
    step = np.gradient(path, axis=1)
    step = step / np.maximum(np.linalg.norm(step, axis=-1, keepdims=True), 1e-9)
    zero = np.zeros(step.shape[:2])
    # Downward paths: `ahead` is the step turned by 90 degrees towards +y.
    ahead = np.stack([zero, -step[..., 1], step[..., 0]], -1)
    return _sweep(center, -RIGHT, ahead, radius)


def _sweep(
    center: np.ndarray, first: np.ndarray, second: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """Vertices (N, rings * SIDES, 3) of elliptic rings around centers (N, rings, 3).

    The half axes of each ring are the products of `radius` (rings, 2) with two directions.
    """
    angle = np.arange(SIDES) * 2 * np.pi / SIDES
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    ring = (
        center[:, :, None]
        + radius[:, None, :1] * c * first[..., None, :]
        + radius[:, None, 1:] * s * second[..., None, :]
    )
    return ring.reshape(len(center), len(radius) * SIDES, 3)
