"""Which people make up a merged silhouette: a body template of known height explains its pixels."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from catfree.adapters.height_profile import HeightProfile

# The template in heights: left, right, top, bottom with x from the body's middle and y down from
# the crown, and the share of the zone that a person fills. Legs open and close.
HEAD = (-0.06, 0.06, 0.0, 0.14)
ZONES = (
    (HEAD, 1.0),
    ((-0.11, 0.11, 0.18, 0.5), 1.0),
    ((-0.13, 0.13, 0.5, 0.75), 0.6),
    ((-0.13, 0.13, 0.75, 0.92), 0.5),
    ((-0.13, 0.13, 0.92, 1.0), 0.4),
)
# What is missing in a zone costs this share of what is there: bodies hide behind things.
MISSING_COST = 0.5
# Beside and above the head and below the feet is nothing of this person; pixels there that nobody
# explains say that the template is misplaced.
SURROUNDINGS = (
    (-0.2, -0.1, 0.0, 0.1),
    (0.1, 0.2, 0.0, 0.1),
    (-0.06, 0.06, -0.12, -0.02),
    (-0.13, 0.13, 1.02, 1.1),
)
SURROUNDINGS_COST = 0.5
# A person is accepted if it explains this share of its template's pixels by itself.
LEAST_GAIN = 0.3
SEARCH_STEP = 2  # pixels
MOST_PEOPLE = 20  # in one blob
WIDTH = 0.36  # of a person's box in heights


class Person(NamedTuple):
    """One explanation of foreground pixels, in reduced pixels.

    Attributes:
        u: column of the body's middle.
        v: row below the foot.
        height: expected height.
        gain: share of the template that it explained by itself.
    """

    u: float
    v: float
    height: float
    gain: float


def split_blob(
    blob: UInt8[np.ndarray, "h w"], box: Int[np.ndarray, "4"], profile: HeightProfile
) -> list[Person]:
    """The people whose templates explain a blob, best explanation first.

    Greedy: the template that explains most pixels not yet explained is taken until none explains
    enough; then each is moved once more with the others in place.

    Args:
        blob: 1 on the blob's pixels.
        box: x1, y1, x2, y2 of the blob, exclusive ends.
        profile: apparent height at each foot pixel.
    """
    import cv2

    u, v, height = _candidates(blob.shape, box, profile)
    if not len(u):
        return []
    covered = cv2.integral(blob)
    people: list[Person] = []
    unexplained = blob.copy()
    for _ in range(MOST_PEOPLE):
        found = _best(covered, unexplained, u, v, height)
        if found is None:
            break
        people.append(found)
        _erase(unexplained, found)
    if len(people) > 1:
        people = _settle(blob, covered, people, u, v, height)
    return people


def _candidates(
    shape: tuple[int, ...], box: Int[np.ndarray, "4"], profile: HeightProfile
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Foot pixels on a grid, and heights, of everybody whose template meets the blob's box."""
    x1, y1, x2, y2 = (int(side) for side in box)
    # Feet may be hidden below the blob, but not farther than a body is long.
    lowest = min(shape[0] * 1.2, y2 + max(profile((x1 + x2) / 2, y2), 0) * 0.6)
    v, u = np.mgrid[y1 : max(lowest, y1 + 1) : SEARCH_STEP, x1:x2:SEARCH_STEP].astype(np.float64)
    u, v = u.ravel(), v.ravel()
    height = profile(u, v)
    # Crowns lie on the blob: between its upper edge and its lower.
    keep = (height >= 8) & (v - height >= y1 - 0.06 * height) & (v - height < y2)
    return u[keep], v[keep], height[keep]


def _rectangle(
    table: Int[np.ndarray, "rows columns"],
    zone: tuple[float, float, float, float],
    u: Float[np.ndarray, " n"],
    v: Float[np.ndarray, " n"],
    height: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Pixels set in a zone of each template, and pixels of it inside the picture."""
    rows, columns = table.shape
    left, right, top, bottom = zone
    x1 = np.clip(np.round(u + left * height), 0, columns - 1).astype(np.int64)
    x2 = np.clip(np.round(u + right * height), 0, columns - 1).astype(np.int64)
    y1 = np.clip(np.round(v - (1 - top) * height), 0, rows - 1).astype(np.int64)
    y2 = np.clip(np.round(v - (1 - bottom) * height), 0, rows - 1).astype(np.int64)
    total = table[y2, x2] - table[y1, x2] - table[y2, x1] + table[y1, x1]
    return total.astype(np.float64), ((x2 - x1) * (y2 - y1)).astype(np.float64)


def _gains(
    covered: Int[np.ndarray, "rows columns"],
    unexplained: UInt8[np.ndarray, "h w"],
    u: Float[np.ndarray, " n"],
    v: Float[np.ndarray, " n"],
    height: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Share of each template that is newly explained, less the background inside it."""
    import cv2

    fresh = cv2.integral(unexplained)
    gain, size, whole = np.zeros(len(u)), np.zeros(len(u)), 0.0
    for zone, share in ZONES:
        own, inside = _rectangle(fresh, zone, u, v, height)
        anybody, _ = _rectangle(covered, zone, u, v, height)
        filled = share * inside
        gain += np.minimum(own, filled) - MISSING_COST * np.maximum(filled - anybody, 0)
        size += filled
        whole += share * (zone[1] - zone[0]) * (zone[3] - zone[2])
    for zone in SURROUNDINGS:
        gain -= SURROUNDINGS_COST * _rectangle(fresh, zone, u, v, height)[0]
    # A template mostly outside the picture explains little.
    return gain / np.maximum(size, 0.5 * whole * height**2)


def _best(
    covered: Int[np.ndarray, "rows columns"],
    unexplained: UInt8[np.ndarray, "h w"],
    u: Float[np.ndarray, " n"],
    v: Float[np.ndarray, " n"],
    height: Float[np.ndarray, " n"],
) -> Person | None:
    gain = _gains(covered, unexplained, u, v, height)
    at = int(np.argmax(gain))
    if gain[at] < LEAST_GAIN:
        return None
    return Person(float(u[at]), float(v[at]), float(height[at]), float(gain[at]))


def _erase(unexplained: UInt8[np.ndarray, "h w"], person: Person) -> None:
    """Mark what a person explains: arms and hair reach a little past the zones."""
    for left, right, top, bottom in ((-0.09, 0.09, -0.05, 0.2), (-0.17, 0.17, 0.15, 1.03)):
        x1, x2 = (max(0, round(person.u + side * person.height)) for side in (left, right))
        y1, y2 = (max(0, round(person.v - (1 - side) * person.height)) for side in (top, bottom))
        unexplained[y1:y2, x1:x2] = 0


def _settle(
    blob: UInt8[np.ndarray, "h w"],
    covered: Int[np.ndarray, "rows columns"],
    people: list[Person],
    u: Float[np.ndarray, " n"],
    v: Float[np.ndarray, " n"],
    height: Float[np.ndarray, " n"],
) -> list[Person]:
    """Move each person once to where it explains most beside the others; drop the needless."""
    settled = list(people)
    for person in people:
        others = [other for other in settled if other is not person]
        unexplained = blob.copy()
        for other in others:
            _erase(unexplained, other)
        near = np.hypot(u - person.u, v - person.v) < 0.3 * person.height
        found = _best(covered, unexplained, u[near], v[near], height[near]) if near.any() else None
        settled = others if found is None else [*others, found]
    return settled
