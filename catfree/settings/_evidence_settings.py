"""The settings of the evidence method; their defaults are the same for all data.

`docs/evidence_constants.md` is generated from the reasons given here, with the effect of each
constant.

Lengths are in units of H0, the median person height of the sequence, so that the method does not
depend on the scale of the scene; pixels are shares of the box height or of the focal length;
log-odds use the natural logarithm.
"""

from dataclasses import dataclass

from catfree.settings._checked_settings import CheckedSettings, constant


@dataclass(frozen=True)
class EvidenceSettings(CheckedSettings):
    """The evidence method: learn, observe, group, weigh, follow, report.

    The first block switches the ingredients on or off, for ablations.

    Attributes:
        use_misses: count cameras that should see a person but do not as evidence against the
            person.
        self_calibrate: estimate the noise of each camera's box edges and the people's height.
        residual_field: estimate a smooth offset of each camera's box edges, a small bundle
            adjustment.
        local_clutter: estimate the clutter ratio per camera and place; otherwise a box is as likely
            false as true.
        use_height: use the top edge and the height prior in addition to the foot.
        track: link over time, smooth, and associate again with the tracks as priors.
        use_appearance: use embeddings if present.
        link_by_looks: link tracks by appearance in addition to motion and height.
        working_area: report positions only where the geometry of the rig determines them well.
        uneven_ground: let people stand off the plane by `unevenness`.
        pose_errors: include the error of the whole map in the ellipses; positions do not change.

        edge_noise: initial noise of center, top and bottom in box heights.
        angular_noise: usual calibration error in radians, common to boxes of all sizes.
        far_more_evidence: ratio of evidence above which starting from twice the largest calibration
            error is preferred to starting from the usual one.
        ankle_factor: noise factor of a bottom edge unless both ankles are detected.
        lower_body: share of a box that shows the legs from the knees down.
        cover_ramp: hidden shares of the lower body between which its bottom edge becomes less
            precise.
        cover_slope: noise that the bottom edge gains per hidden share within `cover_ramp`.
        border_margin: share of the image width within which an edge counts as cut.
        side_cut_noise: center noise of a box cut at the side.
        foot_outlier: share of bottom edges that are not at the feet, so that neither place nor
            height is reliable.
        largest_sigma: a single view with a larger uncertainty, in H0, carries no information.

        calibration_frames: largest number of frames, evenly spread, to learn from.
        fewest_samples: least number of people or steps to learn from; also the prior weight of the
            usual noise, in residuals, and of the overall detection rate, in sightings per class.
        fewest_pairs: least number of pairs of one person, and of two people, to learn appearance
            from.
        least_noise: smallest noise of an edge relative to its initial value.
        angular_noise_range: bounds of the calibration error in radians.
        field_prior: prior standard deviation of the offset's coefficients (focal, column, row,
            box height).
        height_spread_range: bounds of the spread of heights; learning starts at their geometric
            mean.
        density_start: initial density of people per H0².

        appearance_weight: discount of the ratios between boxes of one person.
        appearance_limit: largest log-likelihood ratio of one pair.
        gate: largest squared Mahalanobis distance of two boxes of one person, and of a link.

        witnesses: other cameras that must see a person for a detection to be counted (all others if
            there are fewer); cameras that must see a person for noise, speed and appearance to be
            learned; and whole views of a place that `missing_views` never excludes.
        body_ramp: share of the body inside the image between "cut off" and "in view".
        cover_edges: boundaries between classes of hidden share, each with its own detection rate;
            the last is also the share of a body inside an image that counts as whole.
        height_quantiles: quantiles of a camera's box heights between small, usual and large people.
        detection_rate_start: detection rate of all cameras before counting.
        detection_rate_range: bounds of the detection rate of a class before counting, which may
            halve the distance to certainty; the lower bound applies to cameras that saw somebody.
        clutter_pseudo_counts: prior weight, in boxes, of a camera's clutter ratio at one place.
        clutter_range: bounds of the ratio of clutter to people.
        outage_expected: expected detections in an empty picture above which the picture counts as
            missing.

        passes: passes of association and tracking, each with the tracks of the previous pass as
            priors.
        position_jitter: displacement that no velocity explains, H0 per frame.
        height_jitter: H0 per frame.
        fastest: H0 per frame and axis; longer steps are errors, and half of it is assumed until
            enough steps have been seen.
        memory: correlation of the velocity over one frame, until it has been estimated.
        sudden: factor by which identities forget velocities faster than people do on average.
        gap: frames for which a track may go unseen.
        gap_penalty: log-odds for each of these frames.
        evidence_limit: bound on one frame's log-odds; half of it makes a group certain, or
            hopeless.
        change_evidence: summed log-odds that a track must reach to appear, and to vanish and
            return.

        personal_space: tracks closer than this in a frame are one person, and the better supported
            one is kept; 0 switches it off.
        sway: distance of the body's center from its position; common to all cameras and therefore
            invisible in the residuals between them.
        unevenness: standard deviation of the feet from the plane.
        report_radius: a position is reported if it is more likely than not to be correct within
            this many H0.
        working_sigma: largest predicted uncertainty, relative to the typical place.
        most_places: share of the places that are in at least the usual number of images.
        missing_views: a place is outside the working area if the number of images that show the
            whole body is below the usual number by at least this share of the cameras that see
            anybody. If the usual number is less than that, or than `witnesses`, no place is
            excluded.
    """

    not_zero = frozenset(
        {
            "calibration_frames",
            "fewest_samples",
            "gate",
            "density_start",
            "fastest",
            "report_radius",
            "height_spread_range",
            "field_prior",
            "foot_outlier",
            "clutter_range",
            "detection_rate_start",
            "detection_rate_range",
            "working_sigma",
            "largest_sigma",
            "evidence_limit",
        }
    )
    shares = frozenset(
        {
            "foot_outlier",
            "height_quantiles",
            "detection_rate_start",
            "detection_rate_range",
            "most_places",
        }
    )

    use_misses: bool = True
    self_calibrate: bool = True
    residual_field: bool = True
    local_clutter: bool = True
    use_height: bool = True
    track: bool = True
    use_appearance: bool = True
    link_by_looks: bool = True
    working_area: bool = True
    uneven_ground: bool = True
    pose_errors: bool = True

    # Observe: one box as a likelihood.
    edge_noise: tuple[float, float, float] = constant(
        (0.05, 0.04, 0.05),
        "start",
        "detectors place an edge to a few percent, and people sway and step by as much; learned "
        "per camera and edge",
    )
    angular_noise: float = constant(
        0.003,
        "start",
        "a sixth of a degree is typical of a checkerboard calibration or a good bundle adjustment; "
        "learned. Also counts as one degree of freedom in the error of the whole map",
    )
    far_more_evidence: float = constant(
        1.05,
        "decision",
        "if the cameras agree, both attempts reach the same evidence to within 2 %; if they split "
        "into subsets that disagree, the difference is tens of percent",
    )
    ankle_factor: float = constant(
        1.7,
        "physical",
        "feet hidden behind a shin or a curb are off by about 8 % of the height, against 5 % in "
        "the open",
    )
    lower_body: float = constant(0.3, "physical", "the legs from the knees down")
    cover_ramp: tuple[float, float] = constant(
        (0.2, 0.8),
        "physical",
        "with a fifth of the legs hidden a foot is still visible; with four fifths hidden "
        "detectors draw the box that they expect, and the noise does not grow further",
    )
    cover_slope: float = constant(
        4.0,
        "physical",
        "the box ends anywhere in the hidden part, so its noise grows in proportion, up to 3.4 "
        "times the usual",
    )
    border_margin: float = constant(
        0.004,
        "physical",
        "8 pixels of 1920: boxes of cut people end up to this far inside the image",
    )
    side_cut_noise: float = constant(
        0.3, "physical", "half of a body's width is 0.2 to 0.4 of its height"
    )
    foot_outlier: float = constant(
        0.1,
        "physical",
        "one bottom edge in ten is not a foot (bags, furniture, reflections); the share of the "
        "uniform part of the mixture, and of cases in which heights do not help to identify people",
    )
    largest_sigma: float = constant(
        2.5, "decision", "a view less precise than a room carries no information"
    )

    # Learn: noise, offsets and people of the sequence.
    calibration_frames: int = constant(
        60, "numerical", "ten parameters per camera from hundreds of boxes"
    )
    fewest_samples: int = constant(10, "decision", "a mean is then known to a third of a deviation")
    fewest_pairs: int = constant(50, "decision", "both spreads are then known to a sixth")
    least_noise: float = constant(
        0.7,
        "physical",
        "no detector has less than 0.7 of the usual edge noise on moving people; lower estimates "
        "are due to groups selected for agreement",
    )
    angular_noise_range: tuple[float, float] = constant(
        (0.001, 0.012),
        "physical",
        "from 1 mrad, a pixel of 1920, to 12 mrad, 0.7 degrees; worse rigs are refused",
    )
    field_prior: tuple[float, float, float, float] = constant(
        (0.006, 0.006, 0.006, 0.03),
        "physical",
        "0.6 % of the focal length, 0.3 degrees, is a fairly well known pitch or principal point; "
        "3 % of the box height is a detector that draws loose boxes. The boxes of one person share "
        "their errors, so a prior twice as wide would follow the errors of few people",
    )
    height_spread_range: tuple[float, float] = constant(
        (0.03, 0.12),
        "physical",
        "3 %: children of one age; 12 %: adults with children. Adults differ by 5 to 7 % of their "
        "median height; learned",
    )
    density_start: float = constant(
        0.3, "start", "one per ten square meters, as on a sidewalk; learned"
    )

    # Group: boxes of one person.
    appearance_weight: float = constant(
        0.5,
        "decision",
        "pairwise ratios of one person are not independent: of the six pairs of four views, only "
        "three (half) are; the boxes of a track's next group count as independent",
    )
    appearance_limit: float = constant(
        4.0, "decision", "one pair of images never claims less than one error in fifty (exp 4)"
    )
    gate: float = constant(
        16.0,
        "decision",
        "99.97 % in two dimensions: it only finds candidates, and evidence decides",
    )

    # Weigh: misses and clutter.
    witnesses: int = constant(3, "decision", "two cameras may agree on a ghost, three do not")
    body_ramp: tuple[float, float] = constant(
        (0.3, 0.7),
        "physical",
        "detectors miss most people if only the legs or the head are in view",
    )
    cover_edges: tuple[float, float, float, float] = constant(
        (0.15, 0.4, 0.7, 0.95),
        "decision",
        "nothing, an arm, half, nearly all, all of the body but a hand or a hat",
    )
    height_quantiles: tuple[float, float] = constant(
        (0.15, 0.5), "decision", "people far away are missed more often than others"
    )
    detection_rate_start: float = constant(0.8, "start", "of a standing, unhidden person; learned")
    detection_rate_range: tuple[float, float] = constant(
        (0.02, 0.98),
        "decision",
        "nothing is certain or impossible; after counting, a miss is never evidence of more than a "
        "hundred to one",
    )
    clutter_pseudo_counts: float = constant(
        20.0, "decision", "with fewer than twenty boxes, a place follows its camera"
    )
    clutter_range: tuple[float, float] = constant(
        (0.2, 10.0),
        "decision",
        "below 0.2 the ratio would reinforce itself, because expectation maximization exaggerates "
        "it; above ten a place shows no people anyway",
    )
    outage_expected: float = constant(
        3.0,
        "decision",
        "an empty picture where three people are expected has a chance of 5 %, or is an outage",
    )

    # Follow: tracks and presence.
    passes: int = constant(3, "numerical", "the third changes little")
    position_jitter: float = constant(0.03, "physical", "steps and sway")
    height_jitter: float = constant(0.005, "physical", "people bend and straighten")
    fastest: float = constant(1.0, "physical", "walking fast at 2 frames per second")
    memory: float = constant(0.85, "start", "people turn within a few steps; learned")
    sudden: float = constant(
        2.0,
        "physical",
        "people keep their velocity and then turn or stop within a step: a filter that forgets "
        "twice as fast follows them",
    )
    gap: int = constant(
        4,
        "physical",
        "two seconds at the usual 2 frames per second: behind a pillar or a group",
    )
    gap_penalty: float = constant(
        0.7, "physical", "in each frame half of those who disappeared do not return"
    )
    evidence_limit: float = constant(
        6.0,
        "decision",
        "one frame never claims less than one error in 400 (exp 6): errors of consecutive frames "
        "are correlated",
    )
    change_evidence: float = constant(
        8.0,
        "decision",
        "two frames at the limit, or four with moderate evidence: chance groups last one frame",
    )

    # Report: positions, their covariances, the working area.
    personal_space: float = constant(
        0.15, "physical", "a quarter of a meter is the depth of a body"
    )
    sway: float = constant(
        0.04,
        "physical",
        "7 cm: the sideways sway of the trunk in a step and the difference between the middle of "
        "the body and of the feet",
    )
    unevenness: float = constant(
        0.07, "physical", "12 cm: paving, slopes and curbs over a square, and lifted feet"
    )
    report_radius: float = constant(
        0.3, "physical", "half a meter for adults, the usual criterion for a correct position"
    )
    working_sigma: float = constant(
        2.8, "decision", "an eighth of the information of a typical place"
    )
    most_places: float = constant(
        0.6, "decision", "a clear majority: people go to the others only now and then"
    )
    missing_views: float = constant(0.5, "decision", "half of the cameras that see anybody")
