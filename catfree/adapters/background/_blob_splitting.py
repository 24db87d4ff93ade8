"""Splitting of merged silhouettes into people by body templates of known height."""

from collections.abc import Sequence
from math import ceil, floor
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from catfree.adapters.background._height_profile import HeightProfile

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
# Missing pixels in a zone cost this share of present ones, because bodies may be occluded.
MISSING_COST = 0.5
# No part of a person is beside or above the head or below the feet; unexplained pixels there
# indicate that the template is misplaced.
SURROUNDINGS = (
    (-0.2, -0.1, 0.0, 0.1),
    (0.1, 0.2, 0.0, 0.1),
    (-0.06, 0.06, -0.12, -0.02),
    (-0.13, 0.13, 1.02, 1.1),
)
SURROUNDINGS_COST = 0.5
# A person is accepted if it alone explains this share of its template's pixels.
LEAST_GAIN = 0.3
SEARCH_STEP = 2  # pixels
MOST_PEOPLE = 20  # in one blob
# An expected person is searched for within this distance, in heights, and half of it up and down:
# an expected position is rarely off by more than half a body's width. The cost of the distance only
# breaks ties.
EXPECTED_REACH = 0.12
EXPECTED_STEP = 0.02
EXPECTED_COST = 5.0  # a twentieth of the template at a tenth of the height
WIDTH = 0.36  # of a person's box in heights

_EDGES = np.array([*(zone for zone, _ in ZONES), *SURROUNDINGS]).T[..., None]
_SHARES = np.array([share for _, share in ZONES])
_TEMPLATE_AREA = float(
    sum(share * (zone[1] - zone[0]) * (zone[3] - zone[2]) for zone, share in ZONES)
)


class Person(NamedTuple):
    """A person who explains foreground pixels, in reduced pixels.

    Attributes:
        u: column of the body's middle.
        v: row below the foot.
        height: expected height.
        gain: share of the template's pixels that only this person explains.
    """

    u: float
    v: float
    height: float
    gain: float


class Expected(NamedTuple):
    """An expected person, in reduced pixels; see `Person`."""

    u: float
    v: float
    height: float


def split_blob(
    blob: UInt8[np.ndarray, "h w"],
    box: Int[np.ndarray, "4"],
    profile: HeightProfile,
    expected: Sequence[Expected] = (),
) -> list[Person]:
    """Find the people whose templates explain a blob, best explanation first.

    Greedy: the template that explains the most unexplained pixels is taken until none explains
    enough; then each is moved once with the others fixed. Expected people come first, each at
    the best place near its expected position, unless others explain the same pixels.

    Args:
        blob: 1 on the blob's pixels.
        box: x1, y1, x2, y2 of the blob, exclusive ends.
        profile: apparent height at each foot pixel.
        expected: the people expected there, if known.
    """
    import cv2

    places = [_candidates(blob.shape, box, profile), *map(_around, expected)]
    every = np.concatenate(places, axis=1)
    if not every.size:
        return []
    # Only the part of the picture that a template can reach is processed.
    x, y, window = _window(blob, every)
    table, corner = cv2.integral(window), np.array([[x], [y], [0]])
    grids = [_Templates(table, place - corner) for place in places]
    people = _settle_expected(window, grids[1:], [(e.u - x, e.v - y) for e in expected])
    if places[0].size:
        people = _split(window, grids[0], people)
    return [person._replace(u=person.u + x, v=person.v + y) for person in people]


class _Templates:
    """Body templates at many places of one blob: u, v and height, as in `Person`."""

    def __init__(
        self, table: Int[np.ndarray, "rows columns"], place: Float[np.ndarray, "3 n"]
    ) -> None:
        """Lay out the templates on a blob's table of sums."""
        self.place = place
        self._corners, inside = _corners(table.shape, place)
        filled = _SHARES[:, None] * inside[: len(ZONES)]
        missing = np.maximum(filled - _sums(table, self._corners[:, : len(ZONES)]), 0)
        self._filled, self._missing = filled, MISSING_COST * missing.sum(axis=0)
        # A template mostly outside the picture explains little.
        self._size = np.maximum(filled.sum(axis=0), 0.5 * _TEMPLATE_AREA * place[2] ** 2)

    def best(
        self,
        unexplained: UInt8[np.ndarray, "h w"],
        rows: Int[np.ndarray, " m"] | slice = slice(None),
        cost: Float[np.ndarray, " m"] | float = 0.0,
    ) -> Person | None:
        """Find the template with the largest gain minus cost, or None if it gains too little.

        The gain is the newly explained share of a template, less the background inside it.
        """
        import cv2

        sums, zones = _sums(cv2.integral(unexplained), self._corners[..., rows]), len(ZONES)
        explained = np.minimum(sums[:zones], self._filled[:, rows]).sum(axis=0)
        around = SURROUNDINGS_COST * sums[zones:].sum(axis=0)
        gain = (explained - self._missing[rows] - around) / self._size[rows]
        if not len(gain):
            return None
        at = int(np.argmax(gain - cost))
        if gain[at] < LEAST_GAIN:
            return None
        u, v, height = self.place[:, rows][:, at].tolist()
        return Person(u, v, height, float(gain[at]))


def _split(
    blob: UInt8[np.ndarray, "h w"], templates: _Templates, known: list[Person]
) -> list[Person]:
    """Add people who explain the remaining pixels to the known people."""
    people, unexplained = list(known), _without(blob, known)
    while len(people) < MOST_PEOPLE:
        person = templates.best(unexplained)
        if person is None:
            break
        people.append(person)
        _erase(unexplained, person)
    return _settle(blob, templates, people, known) if len(people) > 1 else people


def _settle(
    blob: UInt8[np.ndarray, "h w"],
    templates: _Templates,
    people: list[Person],
    known: list[Person],
) -> list[Person]:
    """Move each new person once to where it explains most given the others, or drop it."""
    settled = list(people)
    for person in people[len(known) :]:
        others = [other for other in settled if other is not person]
        unexplained = _without(blob, others)
        u, v, _ = templates.place
        distance = np.hypot(u - person.u, v - person.v)
        moved = templates.best(unexplained, np.flatnonzero(distance < 0.3 * person.height))
        settled = others if moved is None else [*others, moved]
    return settled


def _settle_expected(
    blob: UInt8[np.ndarray, "h w"],
    grids: list[_Templates],
    places: list[tuple[float, float]],
) -> list[Person]:
    """Move each expected person to where it explains most given the others, or drop it."""
    people: list[Person | None] = [
        Person(u, v, float(grid.place[2, 0]), 1.0)
        for grid, (u, v) in zip(grids, places, strict=True)
    ]
    for _ in range(2):
        for index, (grid, (u, v)) in enumerate(zip(grids, places, strict=True)):
            if people[index] is None:
                continue
            others = [one for at, one in enumerate(people) if one is not None and at != index]
            columns, lines, height = grid.place
            square = ((columns - u) ** 2 + (lines - v) ** 2) / height**2
            people[index] = grid.best(_without(blob, others), cost=EXPECTED_COST * square)
    return [person for person in people if person is not None]


def _candidates(
    shape: tuple[int, ...], box: Int[np.ndarray, "4"], profile: HeightProfile
) -> Float[np.ndarray, "3 n"]:
    """List foot pixels on a grid, with heights, at which a template meets the blob's box."""
    x1, y1, x2, y2 = (int(side) for side in box)
    # Feet may be hidden below the blob, but by less than the length of a body.
    lowest = min(shape[0] * 1.2, y2 + max(profile((x1 + x2) / 2, y2), 0) * 0.6)
    v, u = np.mgrid[y1 : max(lowest, y1 + 1) : SEARCH_STEP, x1:x2:SEARCH_STEP].astype(np.float64)
    u, v = u.ravel(), v.ravel()
    height = profile(u, v)
    # Crowns are on the blob, between its upper and its lower edge.
    keep = (height >= 8) & (v - height >= y1 - 0.06 * height) & (v - height < y2)
    return np.stack([u, v, height])[:, keep]


def _around(person: Expected) -> Float[np.ndarray, "3 n"]:
    """List foot pixels on a small grid around an expected person, with the height."""
    step = max(1.0, EXPECTED_STEP * person.height)
    count = round(EXPECTED_REACH * person.height / step)
    du, dv = np.meshgrid(
        step * np.arange(-count, count + 1), step * np.arange(-(count // 2), count // 2 + 1)
    )
    u, v = person.u + du.ravel(), person.v + dv.ravel()
    return np.stack([u, v, np.full(len(u), person.height)])


def _window(
    blob: UInt8[np.ndarray, "h w"], candidates: Float[np.ndarray, "3 n"]
) -> tuple[int, int, UInt8[np.ndarray, "y x"]]:
    """Cut out the part of a picture that templates can reach, with its first column and row."""
    u, v, height = candidates
    rows, columns = blob.shape
    x1, x2 = (u - 0.25 * height).min(), (u + 0.25 * height).max()
    y1, y2 = (v - 1.15 * height).min(), (v + 0.15 * height).max()
    left, right = (min(max(x, 0), columns) for x in (floor(x1), ceil(x2)))
    top, bottom = (min(max(y, 0), rows) for y in (floor(y1), ceil(y2)))
    return left, top, np.ascontiguousarray(blob[top : max(bottom, top + 1), left : right + 1])


def _corners(
    shape: tuple[int, ...], place: Float[np.ndarray, "3 n"]
) -> tuple[Int[np.ndarray, "4 z n"], Float[np.ndarray, "z n"]]:
    """Index all zones' corners in a flat table of sums, and count their pixels in the picture.

    Zones first, their surroundings last.
    """
    rows, columns = shape
    u, v, height = place
    left, right, top, bottom = _EDGES
    x1, x2 = (_whole(u + side * height, columns) for side in (left, right))
    y1, y2 = (_whole(v - (1 - side) * height, rows) for side in (top, bottom))
    corners = np.stack([y2 * columns + x2, y1 * columns + x2, y2 * columns + x1, y1 * columns + x1])
    return corners, ((x2 - x1) * (y2 - y1)).astype(np.float64)


def _whole(coordinate: Float[np.ndarray, "z n"], count: int) -> Int[np.ndarray, "z n"]:
    return np.minimum(np.maximum(np.rint(coordinate), 0), count - 1).astype(np.int64)


def _sums(
    table: Int[np.ndarray, "rows columns"], corners: Int[np.ndarray, "4 z n"]
) -> Float[np.ndarray, "z n"]:
    """Count the set pixels in each rectangle."""
    a, b, c, d = table.ravel()[corners]
    return (a - b - c + d).astype(np.float64)


def _without(blob: UInt8[np.ndarray, "h w"], people: Sequence[Person]) -> UInt8[np.ndarray, "h w"]:
    """Select the blob's pixels that these people do not explain."""
    unexplained = blob.copy()
    for person in people:
        _erase(unexplained, person)
    return unexplained


def _erase(unexplained: UInt8[np.ndarray, "h w"], person: Person) -> None:
    """Clear the pixels that a person explains; arms and hair extend a little beyond the zones."""
    for left, right, top, bottom in ((-0.09, 0.09, -0.05, 0.2), (-0.17, 0.17, 0.15, 1.03)):
        x1, x2 = (max(0, round(person.u + side * person.height)) for side in (left, right))
        y1, y2 = (max(0, round(person.v - (1 - side) * person.height)) for side in (top, bottom))
        unexplained[y1:y2, x1:x2] = 0
