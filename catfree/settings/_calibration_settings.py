"""The constants of the calibration from pedestrians and their reasons, the same for all data.

`docs/calibration_constants.md` is generated from the reasons given here.
"""

from dataclasses import dataclass

from catfree.settings._checked_settings import CheckedSettings, constant


@dataclass(frozen=True)
class CalibrationSettings(CheckedSettings):
    """Constants of `catfree.calibrate`.

    Lengths are in meters, angles in radians, pixels in original image pixels.

    Attributes:
        person_height: mean standing height of adults, shoes included; without anchors, the only
            source of scale.
        person_height_sd: spread of standing heights.
        crowd_height_sd: standard deviation of the mean height of the people at one place around
            `person_height`. Images do not reveal it, so it is part of the uncertainty of the scale.
        unusual_height_sd: the same if anchors contradict it: children, or boxes of another kind.
        anchor_level: probability (chi-square) of the difference between an anchor and all other
            evidence below which the anchor is not used.
        foot_offset: distance by which the visible bottom of a box is nearer to the camera than the
            body axis. Boxes hardly constrain it (it trades off with scale and focal length), so it
            is not fitted.
        foot_offset_sd: its uncertainty, part of the uncertainty of the scale.
        box_slack: share of the person's height by which a box is taller than the person, half of it
            above the head and half below the soles.
        box_slack_sd: its uncertainty, part of the uncertainty of the scale.
        pixel_sd: box edge noise that does not depend on the size of the box.
        relative_sd: box edge noise as a share of the box height.
        body_sd: standard deviation of the center of a box from the body axis.
        border: boxes nearer to the image border than this share of the image width count as cut
            and are left out.
        focal_shares: focal lengths to try, as shares of the longer image side.
        focal_log_sd: spread of log focal around the middle of `focal_shares`, a weak prior.
        focal_spread: standard deviation of the log focal lengths of the cameras of one site while
            they are placed.
        roll_sd: weak prior that cameras are mounted upright.
        maximum_frames: longer sequences are evenly subsampled to this many frames.
        voting_frames: number of frames used to vote on placements and to compare many of them.
        scoring_frames: number of frames used to compare few placements.
        voting_angle: bin width of the heading.
        voting_cell: bin width of the translation.
        voting_radius: pairs farther apart than this do not vote.
        chance_weight: share of the chance votes (sequence shifted by half its length) subtracted.
        detection_rates: bounds on the probability that a person who should be seen has a box.
        match_gate: largest squared Mahalanobis distance of a match.
        shared_focal_sd: standard deviation of log focal lengths of cameras of one kind.
        bent_lenses: radial distortion k1 of all lenses to try if ideal lenses place fewer than
            three cameras.
        distortion_sd: spread of the radial distortion k1 of lenses around 0, a weak prior.
        free_lens_gain: share of the cost per person that radial distortion must save to be
            accepted.
        minimum_association: share of explained boxes that an accepted camera must reach.
        minimum_margin: natural-log evidence by which an accepted camera must exceed every shifted
            time.
        chance_shifts: circular time shifts, as shares of the sequence, whose evidence a camera must
            exceed.
        strained_residual: ratio of a camera's residual to the usual one above which the camera is
            flagged.
        largest_focal_sd: largest relative uncertainty of the focal length of an accepted camera.
        minimum_frames: least number of frames with boxes.
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

    # People and their boxes.
    person_height: float = constant(
        1.70, "physical", "adults of both sexes in shoes, the mean of many countries"
    )
    person_height_sd: float = constant(
        0.09, "physical", "adults of both sexes differ by 8 to 10 cm"
    )
    crowd_height_sd: float = constant(
        0.04, "physical", "the means of countries and of crowds differ by a few centimeters"
    )
    unusual_height_sd: float = constant(
        0.4, "physical", "a class of children is 0.4 m shorter than adults"
    )
    foot_offset: float = constant(
        0.15, "physical", "a foot reaches 0.1 m ahead of a standing body, 0.2 m in mid stride"
    )
    foot_offset_sd: float = constant(
        0.10, "physical", "between both feet below the body and a long stride"
    )
    box_slack: float = constant(
        0.02, "physical", "detectors are trained on boxes drawn with a margin of a pixel or two"
    )
    box_slack_sd: float = constant(
        0.02, "physical", "from boxes that touch the person to twice the usual margin"
    )
    pixel_sd: float = constant(
        4.0, "physical", "an edge is found to a few pixels, however small the box"
    )
    relative_sd: float = constant(0.025, "physical", "steps and sway: 4 cm of a person")
    body_sd: float = constant(
        0.08, "physical", "arms and bags move the center of a box by a third of half a body's width"
    )
    border: float = constant(
        0.003,
        "physical",
        "6 pixels of 1920: boxes of cut people end up to this far inside the image",
    )
    detection_rates: tuple[float, float] = constant(
        (0.3, 0.9),
        "physical",
        "a camera that misses more people is hardly useful, and every camera misses some",
    )

    # Cameras.
    focal_shares: tuple[float, ...] = constant(
        (0.5, 0.7, 0.9), "start", "90, 71 and 58 degrees of view, near enough to converge to others"
    )
    focal_log_sd: float = constant(
        0.5, "physical", "one lens in three is wider than 99 degrees or narrower than 47"
    )
    focal_spread: float = constant(
        0.1, "start", "a site has cameras of one kind, or of few; learned by the refinement"
    )
    shared_focal_sd: float = constant(
        0.003, "physical", "lenses of one kind differ by some thousandths"
    )
    roll_sd: float = constant(
        0.15, "physical", "cameras are usually upright to within 9 degrees, and seldom off by 17"
    )
    bent_lenses: tuple[float, ...] = constant(
        (-0.15, -0.3),
        "start",
        "a wide lens and an action camera, near enough to converge to others",
    )
    distortion_sd: float = constant(
        0.2, "physical", "from lenses without distortion to action cameras"
    )

    # The search for cameras.
    maximum_frames: int = constant(
        300, "numerical", "static cameras need people in many places, not all frames"
    )
    voting_frames: int = constant(
        36, "numerical", "the votes of all people in them are summed; more frames take longer"
    )
    scoring_frames: int = constant(
        72, "numerical", "twice as many, for the few remaining placements"
    )
    voting_angle: float = constant(0.0698, "numerical", "4 degrees; each placement is refined")
    voting_cell: float = constant(
        1.0, "numerical", "the error of a position in one view; each placement is refined"
    )
    voting_radius: float = constant(
        60.0, "numerical", "farther away, a person is a few pixels high"
    )
    chance_weight: float = constant(
        0.7, "decision", "half a sequence later, some people are at the same place"
    )
    match_gate: float = constant(9.21, "decision", "99 % of a chi-square with 2 degrees of freedom")

    # Which cameras are accepted.
    minimum_frames: int = constant(
        20, "decision", "fewer frames cannot be distinguished from chance"
    )
    minimum_association: float = constant(
        0.5,
        "decision",
        "half: detectors miss people, and the maps of single views are rough",
    )
    minimum_margin: float = constant(
        25.0, "decision", "fitting seven parameters to chance alone gains about ten"
    )
    chance_shifts: tuple[float, ...] = constant(
        (0.04, 0.08, 0.17, 0.29, 0.41, 0.53, 0.67, 0.83, 0.92, 0.96),
        "decision",
        "from a few frames to half the sequence, in both directions",
    )
    largest_focal_sd: float = constant(
        0.125, "decision", "with more, a person 8 m away is misplaced by a meter"
    )

    # The refinement.
    evidence_rounds: int = constant(
        5, "numerical", "cameras usually stop moving after two or three"
    )
    free_lens_gain: float = constant(
        0.03, "decision", "other errors that look like distortion save less"
    )
    strained_residual: float = constant(
        1.5,
        "decision",
        "correctly placed cameras differ by up to 1.3 (lenses, distances); one displaced by a"
        " tenth of its range has twice the usual residual",
    )
    anchor_level: float = constant(0.001, "decision", "one true anchor in a thousand is refused")

    @property
    def apparent_height(self) -> float:
        """Mean height of boxes in meters, including the slack."""
        return self.person_height * (1 + self.box_slack)


# Distance, in body heights, by which the visible foot is nearer to the camera than the body's axis.
FOOT_AHEAD = CalibrationSettings.foot_offset / CalibrationSettings.person_height
