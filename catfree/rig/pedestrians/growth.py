"""From pairs to a rig: seeds, candidates for each further camera, and acceptance."""

from dataclasses import dataclass

import numpy as np

from catfree.rig.pedestrians.adjustment import AdjustedRig, alternate
from catfree.rig.pedestrians.camera_model import LOG_FOCAL, PAN, X, Z
from catfree.rig.pedestrians.constants import CalibrationSettings
from catfree.rig.pedestrians.ground_map import GroundMap, map_ground, visible
from catfree.rig.pedestrians.matching import (
    Judgement,
    chance_density,
    judge,
    mutual_nearest,
    squared_distances,
)
from catfree.rig.pedestrians.observations import BoxGrid
from catfree.rig.pedestrians.people import (
    RigState,
    camera_map,
    group_people,
    seen_by_any,
    smallest_boxes,
)
from catfree.rig.pedestrians.registration import (
    align_rigidly,
    moved_map,
    vote,
    Placement,
)
from catfree.rig.pedestrians.resection import resect
from catfree.rig.pedestrians.single_view import fit_planes

PLACEMENTS_PER_VOTE = 3
QUICK_FRAMES = 24
SHORTLIST = 30
FINALISTS = 6
ROUNDS = (0.08, 0.05, 0.03)


@dataclass(frozen=True)
class PairHypothesis:
    """Two cameras placed relative to each other from their single-view planes.

    Attributes:
        cameras: their indices.
        parameters: (2, 7), the first with pan, X and Y zero.
        judgement: how well their people agree.
        margin: how far the evidence exceeds the highest at shifted times.
    """

    cameras: tuple[int, int]
    parameters: np.ndarray
    judgement: Judgement
    margin: float


@dataclass(frozen=True)
class Verdict:
    """A camera's evidence against the rest of the rig, and what chance reaches.

    Attributes:
        judgement: at the true time.
        chance: highest evidence at the shifted times.
        accepted: whether the camera can be trusted.
    """

    judgement: Judgement
    chance: float
    accepted: bool

    @property
    def margin(self) -> float:
        """Evidence above chance."""
        return self.judgement.evidence - self.chance


class Workspace:
    """Boxes of one sequence with what is computed once from them."""

    def __init__(self, grid: BoxGrid, settings: CalibrationSettings) -> None:
        self.grid, self.settings = grid, settings
        self.smallest = smallest_boxes(grid)
        count = grid.frame_count
        self.voting = grid.at_frames(_spread(count, settings.voting_frames))
        self.quick = grid.at_frames(_spread(count, QUICK_FRAMES))
        self.scoring = grid.at_frames(_spread(count, settings.scoring_frames))
        self._planes: dict[tuple[int, float], np.ndarray] = {}

    def planes(self, camera: int, log_focal: float) -> np.ndarray:
        """Single-view planes of a camera at a focal length, remembered."""
        key = (camera, round(log_focal, 4))
        if key not in self._planes:
            self._planes[key] = fit_planes(self.grid, camera, np.exp(log_focal), self.settings)
        return self._planes[key]

    def local_map(
        self, grid: BoxGrid, camera: int, parameters: np.ndarray, tolerance: float
    ) -> GroundMap:
        """A camera's map of the ground with given parameters."""
        return map_ground(
            parameters,
            grid.u[camera],
            grid.top[camera],
            grid.bottom[camera],
            grid.sd[camera],
            grid.valid[camera],
            self.settings,
            foot_offset=self.settings.foot_offset,
            range_tolerance=tolerance,
        )


def _spread(count: int, wanted: int) -> np.ndarray:
    """Evenly spread frame indices."""
    return np.unique(np.linspace(0, count - 1, min(count, wanted)).round().astype(int))


def search_pair(work: Workspace, one: int, two: int) -> PairHypothesis | None:
    """The best relative placement of two cameras over focal lengths and plane hypotheses."""
    settings = work.settings
    longest = work.grid.size.max(1)
    found: list[tuple[Placement, np.ndarray, np.ndarray]] = []
    for share in settings.focal_shares:
        sides = [work.planes(c, float(np.log(share * longest[c]))) for c in (one, two)]
        maps = [
            [work.local_map(work.voting, c, p, settings.range_tolerance) for p in planes]
            for c, planes in zip((one, two), sides, strict=True)
        ]
        for p, target in zip(sides[0], maps[0], strict=True):
            for q, source in zip(sides[1], maps[1], strict=True):
                found += [(v, p, q) for v in vote(target, source, settings, PLACEMENTS_PER_VOTE)]
    found.sort(key=lambda item: -item[0].score)
    scored = []
    for placement, p, q in found[:SHORTLIST]:
        placement = _settle(work, work.quick, one, two, p, q, placement)
        _, margin = _judge_pair(work, work.quick, one, two, p, placement.place(q), (0.5,))
        scored.append((margin, placement, p, q))
    scored.sort(key=lambda item: -item[0])
    best = None
    for _, placement, p, q in scored[:FINALISTS]:
        placement = _settle(work, work.scoring, one, two, p, q, placement)
        moved = placement.place(q)
        judgement, margin = _judge_pair(
            work, work.scoring, one, two, p, moved, settings.chance_shifts[1::2]
        )
        if best is None or margin > best.margin:
            best = PairHypothesis((one, two), np.stack([p, moved]), judgement, margin)
    return best


def _settle(
    work: Workspace,
    grid: BoxGrid,
    one: int,
    two: int,
    p: np.ndarray,
    q: np.ndarray,
    placement: Placement,
) -> Placement:
    """Iterated closest people: slide the second map onto the first."""
    target = work.local_map(grid, one, p, work.settings.range_tolerance)
    source = work.local_map(grid, two, q, work.settings.range_tolerance)
    for _ in range(3):
        moved = moved_map(source, placement)
        pairs = squared_distances(target, moved)
        time, slot, partner = mutual_nearest(*pairs, work.settings.match_gate)
        if len(time) < 4:
            return placement
        spread = target.covariance[time, slot] + moved.covariance[time, partner]
        weight = 1 / spread.trace(axis1=1, axis2=2)
        angle, translation = align_rigidly(target.xy[time, slot], source.xy[time, partner], weight)
        placement = Placement(angle, translation, placement.score)
    return placement


def _judge_pair(
    work: Workspace,
    grid: BoxGrid,
    one: int,
    two: int,
    p: np.ndarray,
    q: np.ndarray,
    shifts: tuple[float, ...],
) -> tuple[Judgement, float]:
    """Evidence that two placed cameras see the same people, and its margin over chance."""
    settings = work.settings
    a = work.local_map(grid, one, p, settings.range_tolerance)
    b = work.local_map(grid, two, q, settings.range_tolerance)
    size, smallest, offset = grid.size, work.smallest, settings.foot_offset
    return judge_with_chance(
        b,
        a,
        visible(q, size[two], smallest[two], a.xy, a.height, offset),
        visible(p, size[one], smallest[one], b.xy, b.height, offset),
        settings,
        shifts,
    )


def judge_with_chance(
    own: GroundMap,
    others: GroundMap,
    others_expected: np.ndarray,
    own_expected: np.ndarray,
    settings: CalibrationSettings,
    shifts: tuple[float, ...],
) -> tuple[Judgement, float]:
    """The judgement of a camera and how far it exceeds the best at circularly shifted times."""
    density = chance_density(own)

    def at_shift(shift: int) -> Judgement:
        rolled = own if shift == 0 else _rolled(own, shift)
        return judge(
            rolled,
            others,
            density,
            others_expected,
            np.roll(own_expected, shift, axis=0),
            gate=settings.match_gate,
            detection_rates=settings.detection_rates,
        )

    judgement = at_shift(0)
    frames = len(own.xy)
    steps = sorted({round(share * frames) % frames for share in shifts} - {0})
    chance = max((at_shift(step).evidence for step in steps), default=np.inf)
    return judgement, judgement.evidence - chance


def _rolled(people: GroundMap, shift: int) -> GroundMap:
    """A map whose frames are rolled circularly."""
    return GroundMap(
        *(
            np.roll(getattr(people, name), shift, axis=0)
            for name in ("xy", "covariance", "height", "height_sd", "valid")
        )
    )


def judge_camera(
    work: Workspace,
    state: RigState,
    camera: int,
    *,
    grid: BoxGrid | None = None,
    others: GroundMap | None = None,
) -> Verdict:
    """Evidence of a placed camera against the map of the other placed cameras.

    Args:
        work: the sequence.
        state: the rig with the camera.
        camera: which camera.
        grid: frames to judge on; all by default.
        others: the map of the other cameras on these frames, if it is at hand.
    """
    settings = work.settings
    grid = work.grid if grid is None else grid
    if others is None:
        others = group_people(grid, state, settings, without=camera).ground
    own = camera_map(grid, camera, state, settings)
    others_expected = visible(
        state.parameters[camera],
        grid.size[camera],
        work.smallest[camera],
        others.xy,
        others.height,
        state.foot_offset,
    )
    own_expected = seen_by_any(grid, state, own, work.smallest, without=camera)
    judgement, margin = judge_with_chance(
        own, others, others_expected, own_expected, settings, settings.chance_shifts
    )
    accepted = (
        margin > max(settings.minimum_margin, settings.minimum_match_margin * judgement.matches)
        and judgement.association > settings.minimum_association
        and judgement.matches > settings.minimum_matches
    )
    return Verdict(judgement, judgement.evidence - margin, accepted)


def seed_rig(work: Workspace, pair: PairHypothesis) -> AdjustedRig:
    """Two-camera bundle adjustment with free focal lengths."""
    count = work.grid.camera_count
    parameters = np.full((count, 7), np.nan)
    placed = np.zeros(count, bool)
    for camera, values in zip(pair.cameras, pair.parameters, strict=True):
        parameters[camera], placed[camera] = values, True
    state = RigState(
        parameters, placed, work.settings.foot_offset, np.full(count, ROUNDS[0])
    )
    return alternate(work.grid, state, work.settings, shared_focal=False, tolerances=ROUNDS)


def grow_rig(
    work: Workspace, seed: AdjustedRig, pairs: list[PairHypothesis], *, shared_focal: bool
) -> tuple[AdjustedRig, dict[int, Verdict]]:
    """Add cameras to a seed as long as one can be added that stands up to its evidence.

    Args:
        work: the sequence.
        seed: two cameras.
        pairs: all pair hypotheses, for candidates composed through placed cameras.
        shared_focal: whether all cameras have one focal length.

    Returns:
        The rig and the last verdict of each placed camera.
    """
    rig, verdicts = seed, {}
    while not rig.state.placed.all():
        found = {}
        for camera in np.flatnonzero(~rig.state.placed):
            best = _best_candidate(work, rig.state, int(camera), pairs, shared_focal)
            if best is not None:
                found[int(camera)] = best
        if not found:
            break
        state = rig.state
        leading = max(verdict.margin for _, verdict in found.values())
        for camera, (parameters, verdict) in found.items():
            if verdict.margin >= 0.3 * leading:
                state = state.with_camera(camera, parameters, RESECTED_TOLERANCE)
        grown, grown_verdicts = prune_rig(
            work, _refined(work, state, shared_focal), shared_focal=shared_focal
        )
        if grown.state.placed.sum() <= rig.state.placed.sum():
            break
        rig, verdicts = grown, grown_verdicts
    return rig, verdicts


RESECTED_TOLERANCE = 0.05


def _refined(work: Workspace, state: RigState, shared_focal: bool) -> AdjustedRig:
    return alternate(
        work.grid, state, work.settings, shared_focal=shared_focal, tolerances=(0.05, 0.03)
    )


def prune_rig(
    work: Workspace, rig: AdjustedRig, *, shared_focal: bool
) -> tuple[AdjustedRig, dict[int, Verdict]]:
    """Take out, worst first, every camera that the others do not support."""
    while True:
        cameras = np.flatnonzero(rig.state.placed)
        verdicts = {int(c): judge_camera(work, rig.state, int(c)) for c in cameras}
        failing = [c for c, verdict in verdicts.items() if not verdict.accepted]
        if not failing or len(cameras) <= 2:
            return rig, verdicts
        worst = min(failing, key=lambda c: verdicts[c].margin)
        rig = _refined(work, rig.state.without_camera(worst), shared_focal)


def drop_harmful(
    work: Workspace, rig: AdjustedRig, verdicts: dict[int, Verdict], *, shared_focal: bool
) -> tuple[AdjustedRig, dict[int, Verdict]]:
    """Take out cameras without which the others agree better.

    A camera with a wrong clock can find a place where habits of the crowd (a path, a queue) match
    often enough to beat chance. It stands out twice: each of its matches says little, and it bends
    the rest of the rig.
    """
    while len(verdicts) > 2:
        per_match = {c: v.margin / max(1, v.judgement.matches) for c, v in verdicts.items()}
        usual = float(np.median(list(per_match.values())))
        suspects = [c for c in verdicts if per_match[c] < SUSPICIOUS_SHARE * usual]
        for camera in sorted(suspects, key=lambda c: per_match[c]):
            others = [c for c in verdicts if c != camera]
            less = _refined(work, rig.state.without_camera(camera), shared_focal)
            found = {c: judge_camera(work, less.state, c) for c in others}
            without = sum(verdict.margin for verdict in found.values())
            if without > HARMFUL_GAIN * sum(verdicts[c].margin for c in others):
                rig, verdicts = less, found
                break
        else:
            break
    return rig, verdicts


SUSPICIOUS_SHARE = 0.7  # of the usual evidence per match, below which a camera is looked at
HARMFUL_GAIN = 1.05  # evidence of the others must rise by this much to take a camera out


def _best_candidate(
    work: Workspace,
    state: RigState,
    camera: int,
    pairs: list[PairHypothesis],
    shared_focal: bool,
) -> tuple[np.ndarray, Verdict] | None:
    """The accepted placement of a camera with the highest margin, refined, or None."""
    settings = work.settings
    scoring = work.scoring
    people = group_people(scoring, state, settings).ground
    log_focals = state.parameters[state.placed, LOG_FOCAL]
    middle = float(np.median(log_focals))
    prior = (middle, 0.02 if shared_focal else settings.focal_log_sd)
    best = None
    for start in _candidates(work, state, camera, pairs, middle, shared_focal):
        parameters = resect(
            scoring,
            camera,
            start,
            people,
            settings,
            foot_offset=state.foot_offset,
            log_focal=prior,
        )
        if parameters is None:
            continue
        verdict = judge_camera(
            work,
            state.with_camera(camera, parameters, RESECTED_TOLERANCE),
            camera,
            grid=scoring,
            others=people,
        )
        if verdict.accepted and (best is None or verdict.margin > best[1].margin):
            best = parameters, verdict
    return best


def _candidates(
    work: Workspace,
    state: RigState,
    camera: int,
    pairs: list[PairHypothesis],
    middle: float,
    shared_focal: bool,
) -> list[np.ndarray]:
    """Distinct placements of a camera: votes against the rig's people, and pair edges."""
    settings = work.settings
    people = group_people(work.voting, state, settings).ground
    log_focals = [middle] if shared_focal else [middle, middle - 0.22, middle + 0.22]
    votes = []
    for log_focal in log_focals:
        for plane in work.planes(camera, log_focal):
            own = work.local_map(work.voting, camera, plane, settings.range_tolerance)
            votes += [(v, plane) for v in vote(people, own, settings, 2)]
    votes.sort(key=lambda item: -item[0].score)
    starts = [placement.place(plane) for placement, plane in votes[:12]]
    edges = [p for p in pairs if camera in p.cameras and state.placed[list(p.cameras)].sum() == 1]
    edges.sort(key=lambda pair: -pair.margin)
    composed = [_compose(state, pair, camera) for pair in edges[:3]]
    kept: list[np.ndarray] = []
    for start in composed[:1] + starts + composed[1:]:
        if not any(
            np.linalg.norm(start[X:Z] - other[X:Z]) < 1.2
            and np.cos(start[PAN] - other[PAN]) > np.cos(0.1)
            for other in kept
        ):
            kept.append(start)
    return kept[:CANDIDATES]


CANDIDATES = 4


def _compose(state: RigState, pair: PairHypothesis, camera: int) -> np.ndarray:
    """A camera placed through its pair with a placed one."""
    index = pair.cameras.index(camera)
    own, anchor = pair.parameters[index], pair.parameters[1 - index]
    placed = state.parameters[pair.cameras[1 - index]]
    turned = placed[PAN] - anchor[PAN]
    translation = placed[X:Z] - Placement(turned, np.zeros(2), 0.0).place(anchor)[X:Z]
    return Placement(turned, translation, 0.0).place(own)
