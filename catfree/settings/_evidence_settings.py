"""The settings of the evidence method; their defaults are the same for all data.

`docs/evidence_constants.md` lists them, and the constants of its modules, with their reasons.

Lengths are in units of H0, the median person height of the sequence, so that the method does not
depend on the scale of the scene; pixels are shares of the box height or of the focal length.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class EvidenceSettings:
    """The evidence method: measure, self-calibrate, associate, existence, track, output.

    The first block switches the ingredients on or off, for ablations.

    Attributes:
        use_misses: count cameras that should see a person and do not as evidence against it.
        self_calibrate: estimate the noise of each camera's box edges and the people's height.
        residual_field: estimate a smooth offset of each camera's box edges, a small bundle
            adjustment.
        local_clutter: estimate the clutter ratio per camera and place; otherwise `clutter_start`.
        use_height: use the top edge and the height prior, not only the foot.
        track: link over time, smooth, and associate again with the tracks as priors.
        use_appearance: use embeddings if present.
        link_by_looks: link tracks by appearance too, not only by motion and height.
        working_area: report positions only where the geometry of the rig determines them well.
        uneven_ground: let people stand off the plane by `unevenness`.
        pose_errors: include the error of the whole map in the ellipses; positions do not change.

        edge_noise: initial noise of center, top and bottom in box heights: a detector places an
            edge to a few percent, and people sway and step by as much.
        angular_noise: initial calibration error in radians, common to boxes of all sizes.
        ankle_factor: noise factor of a bottom edge unless both ankles are seen.
        cover_slope: hidden feet: bottom noise x (1 + slope x hidden share beyond `cover_free`).
        cover_free: share of the lower box that may be hidden without effect.
        cover_limit: a hidden share beyond this adds no more noise.
        border_margin: share of the image width within which an edge counts as cut.
        side_cut_noise: center noise of a box cut at the side, half a body's width.
        foot_outlier: share of bottom edges that are not at the feet at all, so that neither place
            nor height can be relied upon.
        newton_steps: Gauss-Newton steps of a single box; it converges in three or four.
        largest_sigma: a single view with a larger uncertainty, in H0, carries no information.

        calibration_rounds: rounds of self-calibration; the third changes little.
        calibration_frames: largest number of frames, evenly spread; enough for all parameters.
        noise_factor_range: bounds of the edge noise relative to its initial value.
        angular_noise_range: bounds of the calibration error in radians.
        field_prior: prior standard deviation of the offset's coefficients (focal, column, row,
            box height): one percent of the focal length is a badly calibrated camera.
        height_spread: initial spread of heights; adults differ by 5 to 7 % of their median.
        height_spread_range: bounds of the spread of heights.
        density_start: initial density of people per H0²: one in ten square meters.

        appearance_weight: discount of the ratios between boxes of one person, which are not
            independent.
        appearance_limit: largest ratio of one pair.

        detection_rate_pseudo_counts: strength of the prior of a detection rate.
        detection_rate_start: prior detection rate.
        smallest_detection_rate: lower bound of the detection rate in a camera that saw the person.
        clutter_start: initial number of clutter detections per detection of a person.
        clutter_rounds: rounds of expectation maximization.
        clutter_pseudo_counts: strength of a camera's overall ratio as the prior at each place.
        clutter_range: bounds of the ratio; below the lower bound it would reinforce itself.

        passes: passes of association and tracking, each with the tracks of the previous pass as
            priors.
        gap: frames for which a track may be unseen.
        gap_penalty: log-odds for each of these frames.
        gate: largest squared Mahalanobis distance of a link.
        evidence_limit: bound of one frame's log-odds: consecutive frames are not independent.
        appear_evidence: summed log-odds that a track must reach.
        leave_evidence: log-odds against vanishing and coming back within a track.

        personal_space: tracks closer than this in a frame, the depth of a body, are one person, and
            the better supported one is kept; 0 switches it off.
        report_radius: a position is reported if it is more likely than not to be correct within
            this many H0 (half a meter for adults).
        working_sigma: largest predicted uncertainty, relative to well-seen people.
        missing_views: a place is outside the working area if the whole body is in fewer images
            there than for the typical person, by at least this share of the cameras that see
            anybody. If the typical person is in fewer images than that, no place is excluded.
        enough_views: a place with the whole body in this many images is never excluded by
            `missing_views`: two cameras make a position of any two boxes, a third can contradict.
        unevenness: how far off the plane people stand: paving, slopes and curbs are level to about
            ten centimeters over a square, and walking feet are lifted by as much.
        sway: how far the body's center strays from the point called its position; it is common to
            all cameras and therefore invisible in the residuals between them.
    """

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

    edge_noise: tuple[float, float, float] = (0.05, 0.04, 0.05)
    angular_noise: float = 0.003
    ankle_factor: float = 1.7
    cover_slope: float = 4.0
    cover_free: float = 0.2
    cover_limit: float = 0.6
    border_margin: float = 0.004
    side_cut_noise: float = 0.3
    foot_outlier: float = 0.1
    newton_steps: int = 6
    largest_sigma: float = 2.5

    calibration_rounds: int = 3
    calibration_frames: int = 60
    noise_factor_range: tuple[float, float] = (0.7, 3.0)
    angular_noise_range: tuple[float, float] = (0.001, 0.012)
    field_prior: tuple[float, float, float, float] = (0.01, 0.01, 0.01, 0.05)
    height_spread: float = 0.06
    height_spread_range: tuple[float, float] = (0.03, 0.12)
    density_start: float = 0.3

    appearance_weight: float = 0.5
    appearance_limit: float = 4.0

    detection_rate_pseudo_counts: float = 10.0
    detection_rate_start: float = 0.8
    smallest_detection_rate: float = 0.2
    clutter_start: float = 1.0
    clutter_rounds: int = 6
    clutter_pseudo_counts: float = 20.0
    clutter_range: tuple[float, float] = (0.4, 10.0)

    passes: int = 3
    gap: int = 4
    gap_penalty: float = 0.7
    gate: float = 16.0
    evidence_limit: float = 6.0
    appear_evidence: float = 8.0
    leave_evidence: float = 8.0

    personal_space: float = 0.15
    report_radius: float = 0.3
    working_sigma: float = 3.0
    missing_views: float = 0.5
    enough_views: int = 3
    unevenness: float = 0.07
    sway: float = 0.04
