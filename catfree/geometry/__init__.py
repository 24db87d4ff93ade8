"""Geometry in pure JAX: unbatched functions made for vmap, jit and grad."""

from catfree.geometry._canonical_frame import CanonicalFrame as CanonicalFrame
from catfree.geometry._plane import (
    PlaneFit as PlaneFit,
    fit_plane as fit_plane,
    fit_plane_ransac as fit_plane_ransac,
    intersect_ray as intersect_ray,
    plane_distance as plane_distance,
)
from catfree.geometry._rays import (
    angular_residual as angular_residual,
    height_weight as height_weight,
    pixel_to_ray as pixel_to_ray,
    pose_ratio as pose_ratio,
    ray_weight as ray_weight,
)
from catfree.geometry._similarity import (
    Similarity as Similarity,
    fit_similarity as fit_similarity,
    nearest_rotation as nearest_rotation,
    transform_plane as transform_plane,
    transform_rig as transform_rig,
    transform_scene as transform_scene,
)
from catfree.geometry._triangulation._triangulate import (
    Triangulation as Triangulation,
    triangulate as triangulate,
    triangulate_least_squares as triangulate_least_squares,
)
from catfree.geometry._uncertainty import (
    ground_covariance as ground_covariance,
    ground_sigma as ground_sigma,
    information as information,
)
from catfree.geometry.camera import (
    back_project as back_project,
    distort as distort,
    project as project,
    undistort as undistort,
)
