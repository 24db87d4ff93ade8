"""Camera models: for each lens, pixel to unit ray in camera axes, and point to pixel."""

from catfree.geometry.camera._fisheye import (
    fisheye_pixel as fisheye_pixel,
    fisheye_ray as fisheye_ray,
)
from catfree.geometry.camera._pinhole import (
    back_project as back_project,
    distort as distort,
    pinhole_pixel as pinhole_pixel,
    pinhole_ray as pinhole_ray,
    project as project,
    undistort as undistort,
)
from catfree.geometry.camera._ray_grid import grid_pixel as grid_pixel, grid_ray as grid_ray
from catfree.geometry.camera._rig_cameras import (
    pixels_of_points as pixels_of_points,
    rays_of_pixels as rays_of_pixels,
)
from catfree.geometry.camera._rig_from_rays import rig_from_rays as rig_from_rays
