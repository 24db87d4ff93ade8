"""The constants of the calibration from pedestrians with their reasons, the same for all data."""

from dataclasses import dataclass

from catfree.settings._checked_settings import CheckedSettings


@dataclass(frozen=True)
class CalibrationSettings(CheckedSettings):
    """Constants of `catfree.calibrate`.

    Lengths are in meters, angles in radians, pixels in original image pixels.

    Attributes:
        person_height: mean standing height of adults, shoes included; the only source of scale
            but for anchors.
        person_height_sd: spread of standing heights.
        crowd_height_sd: standard deviation of the mean height of the people at one place around
            `person_height`. Images do not reveal it, so it is part of the uncertainty of the scale.
        unusual_height_sd: the same where anchors contradict it: children, or boxes of another kind.
        anchor_level: probability of the difference between an anchor and everything else (a
            chi-square) below which the anchor is not used.
        foot_offset: how much nearer to the camera than the body axis the visible bottom of a box
            is: a foot reaches 0.1 m ahead of a standing body, 0.2 m in mid stride. Boxes hardly
            constrain it (it trades off with scale and focal length), so it is not fitted.
        foot_offset_sd: its uncertainty, part of the uncertainty of the scale.
        box_slack: share of the person's height by which a box is taller than the person, half of it
            above the head and half below the soles: detectors are trained on boxes drawn with a
            margin of a pixel or two.
        box_slack_sd: its uncertainty, part of the uncertainty of the scale.
        pixel_sd: box edge noise that does not depend on the size of the box.
        relative_sd: box edge noise as a share of the box height.
        body_sd: standard deviation of the center of a box from the body axis.
        border: boxes nearer to the image border than this share of the image width count as cut
            and are left out.
        focal_shares: focal lengths to try, as shares of the longer image side (90, 71, 58 degrees
            of view).
        focal_log_sd: spread of log focal around the middle of `focal_shares`, a weak prior.
        focal_spread: standard deviation of the log focal lengths of the cameras of one site while
            they are placed; the refinement learns how much they differ.
        roll_sd: weak prior that cameras are mounted upright.
        maximum_frames: longer sequences are evenly subsampled to this many frames.
        voting_frames: number of frames used to vote on placements and to compare many of them.
        scoring_frames: number of frames used to compare few placements.
        voting_angle: bin width of the heading.
        voting_cell: bin width of the translation.
        voting_radius: pairs farther apart than this do not vote.
        chance_weight: share of the chance votes (sequence shifted by half its length) subtracted.
        detection_rates: bounds on the probability that a person who should be seen has a box.
        match_gate: largest squared Mahalanobis distance of a match (99 % of a chi-square with 2
            degrees of freedom).
        shared_focal_sd: standard deviation of log focal lengths of cameras of one kind.
        bent_lenses: radial distortion k1 of all lenses to try if ideal lenses place fewer than
            three cameras.
        distortion_sd: spread of the radial distortion k1 of lenses around 0, a weak prior.
        free_lens_gain: share of the cost per person that radial distortion must save to be
            accepted.
        minimum_association: share of explained boxes that an accepted camera must reach.
        minimum_margin: natural-log evidence by which an accepted camera must exceed every shifted
            time; fitting seven parameters to chance alone gains about ten.
        minimum_match_margin: the same per match; a correct camera gains about one.
        minimum_matches: matches that an accepted camera must reach.
        chance_shifts: circular time shifts, as shares of the sequence, whose evidence a camera must
            exceed.
        strained_residual: ratio of a camera's residual to the usual one above which other poses are
            tried, and finally the camera is flagged. Correctly placed cameras differ by up to 1.3
            (lenses, distances); one displaced by a tenth of its range has twice the usual residual.
        unsupported_share: ratio of a camera's share of boxes in confident people to the usual share
            below which other poses are tried: so few boxes fit any pose.
        fewest_to_compare: with fewer cameras, each distorts the others as much as itself, and no
            other poses are tried.
        largest_focal_sd: relative; a camera with a larger uncertainty of the focal length places a
            person 20 m away wrong by a meter, and is not accepted.
        minimum_frames: fewer frames than this cannot be told from chance.
        evidence_rounds: largest number of rounds in which the most certain groups of the evidence
            method refine the rig, until it converges; 0 keeps the registered rig.
    """

    not_zero = frozenset(
        {
            "person_height",
            "person_height_sd",
            "focal_shares",
            "focal_log_sd",
            "focal_spread",
            "roll_sd",
            "maximum_frames",
            "voting_frames",
            "scoring_frames",
            "voting_angle",
            "voting_cell",
            "shared_focal_sd",
            "distortion_sd",
            "detection_rates",
        }
    )
    shares = frozenset({"anchor_level", "detection_rates"})

    person_height: float = 1.70
    person_height_sd: float = 0.09
    crowd_height_sd: float = 0.04
    unusual_height_sd: float = 0.4
    anchor_level: float = 0.001
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
    focal_spread: float = 0.1
    roll_sd: float = 0.15
    maximum_frames: int = 300
    voting_frames: int = 36
    scoring_frames: int = 72
    voting_angle: float = 0.0698
    voting_cell: float = 1.0
    voting_radius: float = 60.0
    chance_weight: float = 0.7
    detection_rates: tuple[float, float] = (0.3, 0.9)
    match_gate: float = 9.21
    shared_focal_sd: float = 0.003
    bent_lenses: tuple[float, ...] = (-0.15, -0.3)
    distortion_sd: float = 0.2
    free_lens_gain: float = 0.03
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
    unsupported_share: float = 0.5
    fewest_to_compare: int = 4
    largest_focal_sd: float = 0.05
    minimum_frames: int = 20
    evidence_rounds: int = 5

    @property
    def apparent_height(self) -> float:
        """Mean height of boxes in meters, including the slack."""
        return self.person_height * (1 + self.box_slack)


# Distance, in body heights, by which the visible foot is nearer to the camera than the body's axis.
FOOT_AHEAD = CalibrationSettings.foot_offset / CalibrationSettings.person_height
