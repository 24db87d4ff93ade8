"""The constants of the paper's method, one frozen dataclass per stage.

Values are the paper's (Table "constants" unless stated otherwise), the same for all data.
Lengths are shares of the scene extent E, angles are radians.
"""

from dataclasses import dataclass
from typing import Literal

from catfree.settings._checked_settings import CheckedSettings

Selection = Literal[
    "none",
    "support",
    "ground_only",
    "uncertainty_add",
    "uncertainty_replace",
    "ground_then_uncertainty_replace",
    "ground_then_uncertainty_add",
    "uncertainty_then_ground",
]


@dataclass(frozen=True)
class RaySettings(CheckedSettings):
    """Ray reliability (Eq. w).

    Attributes:
        sigma_theta: angular noise of a foot ray in radians.
        use_ankles: weight rays without confirmed ankles by the pose ratio.
        use_box_height: weight short boxes by (h / median h)².
        only_confirmed_ankles: drop detections without confirmed ankles (baseline I).
        minimum_weight: floor of w.
    """

    sigma_theta: float = 0.0206
    use_ankles: bool = True
    use_box_height: bool = True
    only_confirmed_ankles: bool = False
    minimum_weight: float = 1e-4


@dataclass(frozen=True)
class TrackletSettings(CheckedSettings):
    """Short per-camera tracks.

    Attributes:
        maximum_shift: largest displacement of the foot in box heights. At two frames per second,
            the rate of the paper's real data, walking at up to 2.1 m/s, where it turns into
            running, is 0.62 of a body height; the noise of two box bottoms adds about a tenth.
        appearance_threshold: largest appearance distance of a link.
    """

    maximum_shift: float = 0.75
    appearance_threshold: float = 0.6


@dataclass(frozen=True)
class AssociationSettings(CheckedSettings):
    """Greedy cross-view partition.

    Attributes:
        residual_factor: largest angular residual of a merge in units of sigma_theta.
        appearance_threshold: largest appearance distance (cosine, [0, 2]) of a merge.
        uniqueness_ratio: a pair of singletons may ignore appearance if its residual is at most
            this share of the best alternative's.
    """

    residual_factor: float = 2.0
    appearance_threshold: float = 0.6
    uniqueness_ratio: float = 0.3


Estimator = Literal["rays", "best_pair", "single_ray"]


@dataclass(frozen=True)
class TriangulationSettings(CheckedSettings):
    """Robust 3-D position (Sec. position estimation).

    Attributes:
        huber_scale: delta as a share of E.
        refit_inliers: refit on the rays within 3 delta.
        estimator: "rays": all rays of the group; "best_pair": only the pair with the smallest sigma
            and its support (baseline B); "single_ray": the ray with the highest w intersected with
            the ground (baseline A).
        constrain_to_ground: constrain the position to the ground (ablation).
    """

    huber_scale: float = 0.01
    refit_inliers: bool = True
    estimator: Estimator = "rays"
    constrain_to_ground: bool = False


@dataclass(frozen=True)
class SelectionSettings(CheckedSettings):
    """The filters between triangulation and trajectories.

    Attributes:
        rms_factor: RMS gate in units of sigma_theta.
        support_factor: support radius in units of sigma_theta.
        exclusive_support: a detection supports only its nearest hypothesis (lineage K).
        gates: the order of the ablation to run.
        fixed_quantile: replace log-Otsu by this quantile of each statistic, or None.
        temporal_frames: frames in which a tracklet pair must be supported; 1 switches it off.
        suppression_radius: NMS radius r as a share of E.
        recover: reconsider candidates farther than r from all accepted ones.
        recovery_cameras: cameras that must support a recovered candidate.
        use_score: break ties of suppression by the seven-signal score.
    """

    shares = frozenset({"fixed_quantile"})

    rms_factor: float = 2.0
    support_factor: float = 1.0
    exclusive_support: bool = False
    gates: Selection = "uncertainty_then_ground"
    fixed_quantile: float | None = None
    temporal_frames: int = 2
    suppression_radius: float = 0.018
    recover: bool = True
    recovery_cameras: int = 3
    use_score: bool = True


@dataclass(frozen=True)
class TrajectorySettings(CheckedSettings):
    """Linking and extension (Sec. trajectories).

    Links join consecutive frames only, which leaves nothing to the paper's gap interpolation.

    Attributes:
        enabled: link positions; if false, they are returned per frame with track_id -1.
        link_radius: largest step between frames as a share of E.
        appearance_weight: weight of the appearance distance against distance / link radius.
        appearance_in_linking: use appearance in the link cost.
        minimum_length: shorter tracks are removed.
        extend: continue tracks at both ends.
        extension_frames: largest number of frames of an extension.
        extension_cameras: cameras that must support an extension.
        extension_support_factor: support radius of an extension in units of sigma_theta.
        velocity_steps: number of last steps whose mean is the velocity.
        appearance_in_extension: require one supporting detection to look like the track.
        remove_short_static: drop short tracks that do not move (lineage BS, off in BT).
        static_length: largest length of a short static track.
        static_radius: largest extent of a static track as a share of E.
    """

    enabled: bool = True
    link_radius: float = 0.04
    appearance_weight: float = 1.5
    appearance_in_linking: bool = True
    minimum_length: int = 2
    extend: bool = True
    extension_frames: int = 2
    extension_cameras: int = 2
    extension_support_factor: float = 1.0
    velocity_steps: int = 3
    appearance_in_extension: bool = True
    remove_short_static: bool = False
    static_length: int = 3
    static_radius: float = 0.018
