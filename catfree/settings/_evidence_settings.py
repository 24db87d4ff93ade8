"""The constants of the evidence method that may be set; the same for all data.

`docs/evidence_constants.md` lists them with their reasons, and those that stand in its modules.

Lengths are in units of H0, the sequence's own median person height, so that nothing depends on the
scale of the scene; pixels are shares of the box height or of the focal length.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class EvidenceSettings:
    """The evidence method: measure, self-calibrate, associate, existence, track, output.

    The first block switches the ingredients, one by one, for the ablation.

    Attributes:
        use_misses: cameras that should see a person and do not speak against it.
        self_calibrate: learn the noise of each camera's box edges and the people's height.
        residual_field: learn a smooth offset of each camera's box edges, a small bundle adjustment.
        local_clutter: learn the clutter ratio per camera and place; otherwise `clutter_start`.
        use_height: the top edge and the height prior take part, not the foot alone.
        track: link over time, smooth, and associate again with the tracks as priors.
        use_appearance: use embeddings where present.
        link_by_looks: tracks go on by looks, too, not by motion and height alone.
        working_area: report only positions where the rig's geometry pins people down.
        uneven_ground: people may stand off the plane, by `unevenness`.
        pose_errors: ellipses hold the error of the whole map; no position depends on it.

        edge_noise: start of the noise of centre, top and bottom in box heights: a detector places
            an edge to a few per cent, and people sway and step by as much.
        angular_noise: start of the calibration error in radians, common to boxes of all sizes.
        ankle_factor: a bottom edge without both ankles seen is this much noisier.
        cover_slope: hidden feet: bottom noise x (1 + slope x hidden share beyond `cover_free`).
        cover_free: share of the lower box that may be hidden at no cost.
        cover_limit: beyond this share more hiding adds nothing.
        border_margin: share of the image width within which an edge counts as cut.
        side_cut_noise: centre noise of a box cut at the side, half a body's width.
        foot_outlier: share of bottom edges that are not at the feet at all.
        newton_steps: Gauss-Newton steps of a single box; it converges in three or four.
        largest_sigma: a single view vaguer than this many H0 says nothing.

        calibration_rounds: rounds of self-calibration; the third changes little.
        calibration_frames: at most this many frames, evenly spread: enough for all parameters.
        noise_factor_range: how far the edge noise may leave its start.
        angular_noise_range: bounds of the calibration error in radians.
        field_prior: prior standard deviation of the offset's coefficients (focal, column, row,
            box height): one per cent of the focal is a badly calibrated camera.
        height_spread: start of the spread of heights; adults differ by 5 to 7 % of their median.
        height_spread_range: bounds of it.
        density_start: people per H0² at the start: one in ten square metres.

        appearance_weight: discount of ratios between boxes of one person: they are not independent.
        appearance_limit: largest ratio of one pair.

        detection_rate_pseudo_counts: strength of the prior of a detection rate.
        detection_rate_start: its value before anything was counted.
        smallest_detection_rate: a person who was seen was visible at least this much.
        clutter_start: clutter detections per person's detection before anything was learned.
        clutter_rounds: rounds of expectation maximization.
        clutter_pseudo_counts: strength of a camera's overall ratio at each place.
        clutter_range: bounds of the ratio; below the lower one it would only confirm itself.

        passes: association and tracking, each with the tracks of the pass before as priors.
        gap: frames that a track may go unseen.
        gap_penalty: log-odds for each of them.
        gate: largest squared Mahalanobis distance of a link.
        evidence_limit: bound of one frame's log-odds: consecutive frames are not independent.
        appear_evidence: summed log-odds that a track must bring.
        leave_evidence: log-odds against vanishing and coming back within a track.

        personal_space: tracks closer than this in a frame, the depth of a body, are one person, and
            the better supported one stays; 0 switches it off.
        report_radius: a position is reported if it is right within this many H0 (half a metre for
            adults) more likely than not.
        working_sigma: largest uncertainty by design, relative to well-seen people.
        missing_views: a place where the whole body is in fewer images than the typical person's, by
            at least this share of the cameras that see anybody, is beyond the ground that the rig
            was built to cover. Where the typical person is in fewer images than that, it excludes
            none.
        enough_views: with the whole body in this many images a place is never too far out for
            that: two cameras make a position of any two boxes, a third one contradicts.
        unevenness: how far off the plane people stand: paving, slopes and kerbs are level to about
            ten centimetres over a square, and walking feet are lifted by as much.
        sway: how far the body's centre strays from the point called its position; common to all
            cameras and therefore invisible to residuals between them.
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
