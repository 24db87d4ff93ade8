"""Every constant of the evidence method, each with its physical reason; the same for all data.

Lengths are in units of H0, the sequence's own median person height, so that nothing depends on the
scale of the scene; pixels are shares of the box height or of the focal length.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class EvidenceSettings:
    """The evidence method: measure, self-calibrate, associate, existence, track, output.

    Attributes:
        use_misses: cameras that should see a person and do not speak against it.
        self_calibrate: learn the noise of each camera's box edges from the sequence.
        residual_field: learn a smooth offset of each camera's box edges (a small bundle adjustment).
        local_clutter: learn the clutter ratio per camera and place; otherwise `clutter_start`.
        use_height: the top edge and the height prior take part, not the foot alone.
        track: link over time, smooth, and associate again with the tracks as priors.
        use_appearance: use embeddings where present.
    """

    use_misses: bool = True
    self_calibrate: bool = True
    residual_field: bool = True
    local_clutter: bool = True
    use_height: bool = True
    track: bool = True
    use_appearance: bool = True

    # Measurement: a detector places an edge to within a share of the box; people sway and step.
    edge_noise: tuple[float, float, float] = (0.05, 0.04, 0.05)  # centre, top, bottom / box height
    angular_noise: float = 0.003  # radians: calibration error, common to boxes of all sizes
    ankle_factor: float = 1.7  # bottom edge where a pose estimator did not see both ankles
    cover_slope: float = 4.0  # bottom edge x (1 + slope x hidden share), feet hidden by others
    cover_free: float = 0.2
    cover_limit: float = 0.6
    border_margin: float = 0.004  # of the image width: an edge this close to the border is cut
    side_cut_noise: float = 0.3  # half a shoulder width of a box that is cut at the side
    foot_outlier: float = 0.1  # share of bottom edges that are not at the feet at all
    newton_steps: int = 6
    largest_sigma: float = 2.5  # H0: a single view vaguer than this says nothing

    # Self-calibration
    calibration_rounds: int = 3
    calibration_frames: int = 60
    noise_factor_range: tuple[float, float] = (1.0, 3.0)
    angular_noise_range: tuple[float, float] = (0.001, 0.012)
    field_prior: tuple[float, float, float, float] = (0.01, 0.01, 0.01, 0.05)
    height_spread: float = 0.06  # start: human heights spread by 5 to 7 % of their median
    height_spread_range: tuple[float, float] = (0.03, 0.12)
    density_start: float = 0.3  # people per H0²: one in 10 m², a populated place

    # Appearance
    appearance_weight: float = 0.5  # pairs of a group are not independent
    appearance_limit: float = 4.0

    # Existence
    detection_rate_pseudo_counts: float = 10.0
    detection_rate_start: float = 0.8
    smallest_detection_rate: float = 0.2
    clutter_start: float = 1.0
    clutter_rounds: int = 6
    clutter_pseudo_counts: float = 20.0
    clutter_range: tuple[float, float] = (0.5, 10.0)

    # Tracking
    passes: int = 3
    gap: int = 4
    gap_penalty: float = 0.7
    gate: float = 16.0
    evidence_limit: float = 6.0
    track_evidence: float = 8.0
    leave_evidence: float = 1.0

    # Output
    duplicate_radius: float = 0.18  # H0: two people cannot stand closer than a body's half-width
    report_radius: float = 0.3  # H0
    working_area: bool = True
    working_sigma: float = 3.0
    working_views: float = 0.6
    sway: float = 0.03
