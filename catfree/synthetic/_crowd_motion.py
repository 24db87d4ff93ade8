"""Motion of a crowd: groups follow waypoints, members keep formation and avoid collisions.

Velocities relax towards a desired velocity, as in the social force model (Helbing and Molnár,
"Social force model for pedestrian dynamics", 1995). Walkers can always turn towards their target,
so they do not circle around a waypoint.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.synthetic._collision_avoidance import (
    around_obstacles,
    avoidance,
    limited,
    outside_obstacles,
    unit,
)

RELAXATION = 0.5  # seconds, time constant of the velocity
PREFERRED_SPEED = (1.25, 0.2)  # m/s, mean and spread of free walking
TOP_SPEED = 2.2  # m/s, a brisk walk to catch up with the group
TOP_ACCELERATION = 3.0  # m/s²
ARRIVAL = 0.7  # meters from a waypoint at which it counts as reached
STANDING_CHANCE = 0.35  # probability that a group stands at a reached waypoint
STEP_LENGTH = 0.72  # meters of one step
ENTRY_MARGIN = 3.0  # meters outside the area at which people appear and vanish
BACKGROUND_BAND = (1.0, 5.0)  # meters outside the area where bystanders stay
BYSTANDER_CLEARANCE = 0.3  # meters that bystanders keep from the area


class Crowd:
    """State of P people in G groups during the integration, in meters and seconds.

    Per group: `side` of the area where bystanders stay, `speed`, position and velocity of the
    `anchor` that its members follow, direction `ahead`, `target` and `stand_until`, and whether it
    is `leaving` or `gone`. Per person: `slot` beside the anchor, `position`, `velocity`, `heading`
    and `stride`.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        *,
        area: tuple[float, float, float, float],
        group: Int[np.ndarray, " p"],
        start: Float[np.ndarray, " g"],
        leave: Float[np.ndarray, " g"],
        background: Bool[np.ndarray, " g"],
        standing: float,
        standing_time: float,
        obstacles: Float[np.ndarray, "k 3"],
    ) -> None:
        """Draw people in motion at time zero; later groups wait at their entry points."""
        self.area, self.obstacles, self.standing_time = area, obstacles, standing_time
        self.group, self.background = group, background
        self.start, self.leave, self.time = start, leave, 0.0
        groups, count = len(start), len(group)
        self.side = rng.integers(4, size=groups)
        self.speed = np.clip(rng.normal(*PREFERRED_SPEED, groups), 0.7, 1.8)
        self.leaving, self.gone = np.zeros(groups, bool), np.zeros(groups, bool)
        self.stride = rng.uniform(0, 2 * np.pi, count)
        # Members walk abreast, 0.7 m apart, each slightly ahead or behind.
        size = np.bincount(group, minlength=groups)
        rank = np.arange(count) - np.searchsorted(group, group)
        across = 0.7 * (rank - (size[group] - 1) / 2)
        self.slot = np.column_stack([across, rng.uniform(-0.2, 0.2, count)])
        all_groups = np.arange(groups)
        self.anchor = _waypoints(self, rng, all_groups)
        late = np.flatnonzero(start > 0)
        self.anchor[late] = _gates(self, rng, late)
        self.target = _waypoints(self, rng, all_groups)
        stands = (rng.uniform(size=groups) < standing) & (start <= 0)
        self.stand_until = np.where(stands, rng.exponential(standing_time, groups), 0.0)
        direction = unit(self.target - self.anchor)
        self.anchor_velocity = direction * (self.speed * ~stands)[:, None]
        self.ahead = np.arctan2(direction[:, 1], direction[:, 0])
        self.position = outside_obstacles(_places(self), obstacles)
        self.velocity = self.anchor_velocity[group].copy()
        turned = self.slot.sum(-1)  # a standing person may face any direction
        heading = self.ahead[group]
        self.heading = np.where(stands[group], heading + turned, heading)

    @property
    def present(self) -> Bool[np.ndarray, " p"]:
        """(P,) true for people who are in the world at the current time."""
        return ((self.start <= self.time) & ~self.gone)[self.group]


def advance_crowd(crowd: Crowd, rng: np.random.Generator, dt: float) -> None:
    """Advance the crowd by `dt` seconds, in place."""
    crowd.time += dt
    _choose_targets(crowd, rng)
    moving = crowd.time >= crowd.stand_until
    active = crowd.start <= crowd.time

    # The anchor of a group walks to its waypoint.
    to_target = crowd.target - crowd.anchor
    desired = unit(to_target) * (crowd.speed * (moving & active))[:, None]
    desired = desired + around_obstacles(crowd.anchor, desired, crowd.obstacles)
    # The anchor waits for members who fall behind.
    behind = _group_mean(crowd, np.linalg.norm(_places(crowd) - crowd.position, axis=-1))
    desired = desired * np.clip(1.5 - behind, 0.2, 1.0)[:, None]
    crowd.anchor_velocity += (
        limited((desired - crowd.anchor_velocity) / RELAXATION, TOP_ACCELERATION) * dt
    )
    crowd.anchor = crowd.anchor + crowd.anchor_velocity * dt
    crowd.ahead = _turned(
        crowd.ahead,
        crowd.anchor_velocity,
        np.linalg.norm(crowd.anchor_velocity, axis=-1) > 0.3,
        rate=2.0,
        dt=dt,
    )

    # Each member heads for its place beside the anchor and avoids others.
    present = crowd.present
    to_place = _places(crowd) - crowd.position
    wanted = crowd.anchor_velocity[crowd.group] + to_place / 0.8
    people = np.flatnonzero(present)
    wanted[people] += avoidance(crowd.position[people], crowd.group[people])
    wanted = wanted + around_obstacles(crowd.position, wanted, crowd.obstacles)
    # Standing people do not shuffle about by a few centimeters.
    calm = np.linalg.norm(wanted, axis=-1) < 0.15
    wanted = np.where(calm[:, None], 0.0, wanted)
    change = (limited(wanted, TOP_SPEED) - crowd.velocity) / RELAXATION
    crowd.velocity = crowd.velocity + limited(change, TOP_ACCELERATION) * dt
    crowd.velocity = np.where(present[:, None], crowd.velocity, 0.0)
    moved = outside_obstacles(crowd.position + crowd.velocity * dt, crowd.obstacles)
    moved = _bystanders_outside(crowd, moved)
    moved = crowd.position + limited(moved - crowd.position, TOP_SPEED * dt)
    crowd.position = np.where(present[:, None], moved, crowd.position)

    speed = np.linalg.norm(crowd.velocity, axis=-1)
    _turn(crowd, speed, dt)
    crowd.stride = crowd.stride + np.pi * speed * dt / (STEP_LENGTH)


def _choose_targets(crowd: Crowd, rng: np.random.Generator) -> None:
    """Give a new waypoint to groups that arrived, and a gate to groups that leave."""
    arrived = np.linalg.norm(crowd.target - crowd.anchor, axis=-1) < ARRIVAL
    arrived &= (crowd.time >= crowd.stand_until) & (crowd.start <= crowd.time)
    crowd.gone |= arrived & crowd.leaving
    time_to_go = ~crowd.leaving & (crowd.time >= crowd.leave) & (crowd.time >= crowd.stand_until)
    going = np.flatnonzero(time_to_go)
    if going.size:
        crowd.leaving[going] = True
        crowd.target[going] = _gates(crowd, rng, going)
    staying = np.flatnonzero(arrived & ~crowd.leaving)
    if staying.size:
        crowd.target[staying] = _waypoints(crowd, rng, staying)
        stands = rng.uniform(size=staying.size) < STANDING_CHANCE
        pause = rng.exponential(crowd.standing_time, staying.size)
        crowd.stand_until[staying] = np.where(stands, crowd.time + pause, 0.0)


def _waypoints(crowd: Crowd, rng: np.random.Generator, groups: np.ndarray) -> np.ndarray:
    """Draw a waypoint per group: anywhere in the area, or for bystanders along their side."""
    x_min, x_max, y_min, y_max = crowd.area
    share = rng.uniform(0.03, 0.97, (len(groups), 2))
    inside = np.array([x_min, y_min]) + share * [x_max - x_min, y_max - y_min]
    near, far = BACKGROUND_BAND
    away = near + rng.uniform(size=len(groups)) * (far - near)
    along = rng.uniform(-0.1, 1.1, len(groups))
    outside = _beside(crowd, crowd.side[groups], along, away)
    points = np.where(crowd.background[groups][:, None], outside, inside)
    return outside_obstacles(points, crowd.obstacles, clearance=1.0)


def _gates(crowd: Crowd, rng: np.random.Generator, groups: np.ndarray) -> np.ndarray:
    """Draw a point per group outside the area, where it appears or vanishes."""
    side = rng.integers(4, size=len(groups))
    along = rng.uniform(0.05, 0.95, len(groups))
    return _beside(crowd, side, along, np.full(len(groups), ENTRY_MARGIN))


def _beside(crowd: Crowd, side: np.ndarray, along: np.ndarray, away: np.ndarray) -> np.ndarray:
    x_min, x_max, y_min, y_max = crowd.area
    x = x_min + along * (x_max - x_min)
    y = y_min + along * (y_max - y_min)
    choices = [
        np.stack([x, y_min - away], -1),
        np.stack([x_max + away, y], -1),
        np.stack([x, y_max + away], -1),
        np.stack([x_min - away, y], -1),
    ]
    return np.choose(side[:, None], choices)


def _places(crowd: Crowd) -> Float[np.ndarray, "p 2"]:
    """Target place of each member: abreast of the anchor, across its direction of travel."""
    angle = crowd.ahead[crowd.group]
    ahead = np.stack([np.cos(angle), np.sin(angle)], -1)
    across = np.stack([-ahead[:, 1], ahead[:, 0]], -1)
    return crowd.anchor[crowd.group] + across * crowd.slot[:, :1] + ahead * crowd.slot[:, 1:]


def _bystanders_outside(crowd: Crowd, points: np.ndarray) -> np.ndarray:
    x_min, x_max, y_min, y_max = crowd.area
    outward = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])[crowd.side[crowd.group]]
    bound = np.array([-y_min, x_max, y_max, -x_min])[crowd.side[crowd.group]]
    lacking = bound + BYSTANDER_CLEARANCE - np.einsum("pi,pi->p", points, outward)
    lacking = np.maximum(lacking, 0.0) * crowd.background[crowd.group]
    return points + lacking[:, None] * outward


def _turn(crowd: Crowd, speed: np.ndarray, dt: float) -> None:
    """Turn walking people to their direction, and people standing in a group to its middle."""
    size = np.bincount(crowd.group, minlength=len(crowd.start))
    middle = np.stack([_group_mean(crowd, crowd.position[:, i]) for i in (0, 1)], -1)
    inward = middle[crowd.group] - crowd.position
    walks = speed > 0.3
    goal = np.where(walks[:, None], crowd.velocity, inward)
    turns = walks | (size[crowd.group] > 1)
    crowd.heading = _turned(crowd.heading, goal, turns, rate=4.0, dt=dt)


def _turned(
    angle: np.ndarray, goal: np.ndarray, turns: np.ndarray, *, rate: float, dt: float
) -> np.ndarray:
    """Turn angles towards goal vectors by at most `rate` rad/s where `turns` is true."""
    error = np.arctan2(goal[:, 1], goal[:, 0]) - angle
    error = (error + np.pi) % (2 * np.pi) - np.pi
    return angle + np.where(turns, np.clip(rate * error, -rate, rate), 0.0) * dt


def _group_mean(crowd: Crowd, values: np.ndarray) -> np.ndarray:
    groups = len(crowd.start)
    total = np.bincount(crowd.group, values, groups)
    return total / np.maximum(np.bincount(crowd.group, minlength=groups), 1)
