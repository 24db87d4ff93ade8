"""Every constant of the calibration from pedestrians, the same for all data, with its reason."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class CalibrationSettings:
    """Constants of `catfree.calibrate`.

    Lengths are metres, angles radians, pixels original image pixels.

    Attributes:
        person_height: mean standing height of adults, shoes included; the only source of scale.
        person_height_sd: spread of standing heights.
        crowd_height_sd: how far the mean height of one place's people may be from `person_height`;
            no picture tells, so it goes into the uncertainty of the scale.
        foot_offset: how much nearer than the body axis the visible bottom of a box stands: a foot
            reaches 0.1 m ahead of a standing body, 0.2 m in mid stride. Boxes say next to nothing
            about it (it trades with scale and focal length), so it is not fitted.
        foot_offset_sd: its uncertainty, which goes into the uncertainty of the scale.
        box_slack: share of its height by which a box is taller than the person, half of it above
            the head and half below the soles: detectors learn from boxes that are drawn around
            people with a pixel or two to spare.
        box_slack_sd: its uncertainty, which goes into the uncertainty of the scale.
        pixel_sd: box edge noise that does not depend on the size of the box.
        relative_sd: box edge noise as a share of the box height.
        body_sd: how far the centre of a box may stand off the body axis.
        border: boxes nearer to the image border than this share of the image width are cut and
            left out.
        focal_shares: focal lengths to try, as shares of the longer image side (90, 71, 58 degrees
            of view).
        focal_log_sd: spread of log focal around the middle of `focal_shares`, a weak prior.
        roll_sd: weak prior that cameras are mounted upright.
        maximum_frames: longer sequences are thinned out evenly to this many frames.
        voting_frames: frames that take part in the voting.
        scoring_frames: frames that take part in the scoring of pairs.
        voting_angle: bin width of the heading.
        voting_cell: bin width of the translation.
        voting_radius: pairs farther apart than this do not vote.
        chance_weight: share of the chance votes (sequence shifted by half its length) taken off.
        detection_rates: bounds on the probability that a person who should be seen has a box.
        range_tolerance: share of the range by which an unrefined map may be wrong.
        fine_range_tolerance: the same after bundle adjustment.
        match_gate: largest squared Mahalanobis distance of a match (99 % of a chi-square with 2).
        seed_pairs: pairs that are refined as seeds.
        shared_focal_spread: focal lengths count as one when their median log ratio is below this.
        shared_focal_sd: how far a shared log focal length may deviate.
        free_focal_gain: share of the cost per person that a focal length for each camera must save
            to be believed.
        minimum_association: share of explained boxes that an accepted camera must reach.
        minimum_margin: natural-log evidence by which an accepted camera must exceed every shifted
            time; fitting seven numbers to chance alone gains about ten.
        minimum_match_margin: the same for each match: a right camera gains about one.
        minimum_matches: matches that an accepted camera must reach.
        chance_shifts: circular time shifts, as shares of the sequence, whose evidence a camera must
            exceed.
        strained_residual: times the usual residual of a camera, above which it is tried elsewhere,
            and in the end flagged. With everybody in place cameras differ by up to 1.3 (lenses,
            distances); one beside its place by a tenth of its range has twice the usual.
        unsupported_share: of the usual share of boxes that sure people hold, below which a camera
            is tried elsewhere: so few fit anywhere.
        blocking_share: a camera without which the others' residual falls below this share of the
            rig's is tried elsewhere where cameras are missing.
        fewest_to_compare: with fewer cameras each bends the others as much as itself, and none is
            tried elsewhere.
        largest_focal_sd: relative; a camera whose focal length is known worse than this puts a
            person 20 m away wrong by a metre, and is not accepted.
        minimum_frames: fewer frames than this cannot be told from chance.
        evidence_rounds: at most so often the evidence method's surest groups refine the rig, until
            it rests; 0 leaves it as it was registered.
    """

    person_height: float = 1.70
    person_height_sd: float = 0.09
    crowd_height_sd: float = 0.04
    foot_offset: float = 0.15
    foot_offset_sd: float = 0.10
    box_slack: float = 0.02
    box_slack_sd: float = 0.02
    pixel_sd: float = 4.0
    relative_sd: float = 0.025
    body_sd: float = 0.08
    border: float = 0.003
    focal_shares: tuple[float, ...] = (0.5, 0.7, 0.9)
    focal_log_sd: float = 0.5
    roll_sd: float = 0.15
    maximum_frames: int = 300
    voting_frames: int = 36
    scoring_frames: int = 72
    voting_angle: float = 0.0698
    voting_cell: float = 1.0
    voting_radius: float = 60.0
    chance_weight: float = 0.7
    detection_rates: tuple[float, float] = (0.3, 0.9)
    range_tolerance: float = 0.08
    fine_range_tolerance: float = 0.01
    match_gate: float = 9.21
    seed_pairs: int = 6
    shared_focal_spread: float = 0.10
    shared_focal_sd: float = 0.003
    free_focal_gain: float = 0.05
    minimum_association: float = 0.45
    minimum_margin: float = 25.0
    minimum_match_margin: float = 0.1
    minimum_matches: int = 15
    chance_shifts: tuple[float, ...] = (
        0.04,
        0.08,
        0.17,
        0.29,
        0.41,
        0.53,
        0.67,
        0.83,
        0.92,
        0.96,
    )
    strained_residual: float = 1.5
    unsupported_share: float = 0.2
    blocking_share: float = 0.9
    fewest_to_compare: int = 4
    largest_focal_sd: float = 0.05
    minimum_frames: int = 20
    evidence_rounds: int = 5

    @property
    def apparent_height(self) -> float:
        """Mean height that boxes show, slack included, in metres."""
        return self.person_height * (1 + self.box_slack)

    def edge_deviation(self, height: np.ndarray) -> np.ndarray:
        """Standard deviation in pixels of the edges of boxes of some heights in pixels."""
        return np.hypot(self.pixel_sd, self.relative_sd * height)
