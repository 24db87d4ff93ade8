"""Simulated people on a plane who walk in groups, stand, enter, leave and avoid each other."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.errors import InvalidInputError
from catfree.synthetic._crowd_motion import Crowd, advance_crowd
from catfree.types._validation import (
    as_area,
    as_count,
    as_duration,
    as_number,
    as_positive,
    as_rows,
    require_finite,
)

Area = tuple[float, float, float, float]

# Adults within a population differ by about 0.08 m. The mean of a population is unknown too, and is
# drawn so that it never equals the 1.70 m that a method may assume.
ASSUMED_HEIGHT = 1.70
HEIGHT_MEAN_SHIFT = (0.03, 0.08)
HEIGHT_SPREAD = 0.08

# Share of groups of one, two, three and four pedestrians (Moussaïd et al. 2010 find about half of
# the people in a street in groups, mostly pairs).
GROUP_SIZE_SHARE = (0.5, 0.32, 0.12, 0.06)

WALK_OUT = 6.0  # seconds between a decision to leave and the next arrival, about the walk out
LONGEST_STEP = 0.125  # seconds; longer frame intervals are integrated in several steps


def middle_and_half(area: Area) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Compute the middle (2,) of an area and half its extents (2,) along x and y."""
    x_min, x_max, y_min, y_max = area
    low, high = np.array([x_min, y_min]), np.array([x_max, y_max])
    return (low + high) / 2, (high - low) / 2


def seeded(seed: int, *stream: int) -> np.random.Generator:
    """Return the generator of one of the random streams of a seed.

    Raises:
        InvalidInputError: if the seed is not a whole number, 0 or more.
    """
    return np.random.default_rng([as_count(seed, "seed", least=0), *stream])


@dataclass(frozen=True)
class Walkers:
    """T frames of P people in meters on the ground z = 0, dense in time and person.

    Attributes:
        position: (T, P, 2) where each person's body axis meets the ground.
        velocity: (T, P, 2) in m/s.
        heading: (T, P) direction the body faces, radians from world x.
        stride: (T, P) phase of the walking cycle in radians; advances 2 pi every two steps.
        present: (T, P) whether the person is in the world.
        height: (P,) body height.
        background: (P,) whether the person is a bystander, who never enters the evaluation area.
        group: (P,) people with equal numbers walk together.
        area: evaluation area (x_min, x_max, y_min, y_max).
        fps: frames per second.
    """

    position: Float[np.ndarray, "t p 2"]
    velocity: Float[np.ndarray, "t p 2"]
    heading: Float[np.ndarray, "t p"]
    stride: Float[np.ndarray, "t p"]
    present: Bool[np.ndarray, "t p"]
    height: Float[np.ndarray, " p"]
    background: Bool[np.ndarray, " p"]
    group: Int[np.ndarray, " p"]
    area: Area
    fps: float | int

    @property
    def inside(self) -> Bool[np.ndarray, "t p"]:
        """(T, P) true where a person is present and inside the evaluation area."""
        x_min, x_max, y_min, y_max = self.area
        x, y = self.position[..., 0], self.position[..., 1]
        return self.present & (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)

    def rows(self, inside_only: bool = True) -> Float[np.ndarray, "n 4"]:
        """Return (N, 4) rows [frame, id, x, y] in meters, as `cf.evaluation` takes them."""
        frame, person = np.nonzero(self.inside if inside_only else self.present)
        return np.column_stack([frame, person, self.position[frame, person]]).astype(np.float64)


def simulate_walkers(
    area: Area,
    *,
    frames: int,
    people: int,
    background: int = 0,
    fps: float | int = 5.0,
    seed: int = 0,
    stay: float | int = 60.0,
    standing: float | int = 0.3,
    standing_time: float | int = 12.0,
    obstacles: Float[np.ndarray, "k 3"] | None = None,
) -> Walkers:
    """Simulate people who walk, stand, enter and leave an area, and bystanders around it.

    Args:
        area: evaluation area (x_min, x_max, y_min, y_max) in meters.
        frames: number of frames T.
        people: usual number of people in or around the area; those who leave are replaced.
        background: number of bystanders outside the area.
        fps: frames per second.
        seed: determines all random draws.
        stay: mean time in seconds until a group leaves.
        standing: share of groups that stand when the sequence begins.
        standing_time: mean time in seconds for which a group stands.
        obstacles: (K, 3) x, y and radius in meters of obstacles to walk around, or None.

    Returns:
        The people, sorted by the time at which they appear.

    Raises:
        InvalidInputError: if a count or a time is negative, the area or the frame rate is not
            positive, `standing` is not a share, or a number is not finite.
    """
    area, fps = as_area(area), as_positive(fps, "fps")
    frames = as_count(frames, "frames", least=1)
    people = as_count(people, "people", least=0)
    background = as_count(background, "background", least=0)
    places = as_rows([] if obstacles is None else obstacles, 3, "obstacles").astype(np.float64)
    require_finite(places, "obstacles")
    share = as_number(standing, "standing")
    if not 0 <= share <= 1:
        raise InvalidInputError(f"standing is {share:g}; it must be a share, from 0 to 1.")
    rng = seeded(seed)
    group, start, leave, is_background = _schedule(
        rng, people, background, duration=frames / fps, stay=as_duration(stay, "stay")
    )
    crowd = Crowd(
        rng,
        area=area,
        group=group,
        start=start,
        leave=leave,
        background=is_background,
        standing=share,
        standing_time=as_duration(standing_time, "standing_time"),
        obstacles=places,
    )
    steps = max(1, int(np.ceil(1 / (fps * LONGEST_STEP) - 1e-9)))
    dt = 1 / (fps * steps)
    record: dict[str, list[np.ndarray]] = {
        name: [] for name in ("position", "velocity", "heading", "stride", "present")
    }
    for frame in range(frames):
        for _ in range(steps if frame else 0):
            advance_crowd(crowd, rng, dt)
        crowd.time = frame / fps
        for name, history in record.items():
            history.append(getattr(crowd, name).copy())
    return Walkers(
        **{name: np.stack(history) for name, history in record.items()},
        height=_body_heights(rng, len(group)),
        background=is_background[group],
        group=group,
        area=area,
        fps=fps,
    )


def _body_heights(rng: np.random.Generator, count: int) -> Float[np.ndarray, " p"]:
    mean = ASSUMED_HEIGHT + rng.choice([-1, 1]) * rng.uniform(*HEIGHT_MEAN_SHIFT)
    spread = np.clip(rng.standard_normal(count), -2.5, 2.5)
    return mean + HEIGHT_SPREAD * spread


def _schedule(
    rng: np.random.Generator, people: int, background: int, *, duration: float, stay: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Draw the group of each person (P,), and when each group comes and goes (G,), in seconds.

    When a group leaves, a new group of the same size comes. Bystanders never leave.
    """
    groups: list[tuple[int, float, float, bool]] = []
    for total, outside in ((people, False), (background, True)):
        remaining = total
        while remaining > 0:
            count = min(remaining, 1 + int(rng.choice(4, p=GROUP_SIZE_SHARE)))
            remaining -= count
            arrival = -1.0  # before the first frame
            while arrival < duration:
                until = np.inf if outside else max(arrival, 0.0) + rng.exponential(stay)
                groups.append((count, arrival, until, outside))
                arrival = until + WALK_OUT + rng.exponential(3.0)
    columns = [("size", int), ("start", float), ("leave", float), ("background", bool)]
    table = np.array(sorted(groups, key=lambda group: group[1]), columns)
    group = np.repeat(np.arange(len(table)), table["size"])
    return group, table["start"], table["leave"], table["background"]
