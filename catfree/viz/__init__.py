"""Visualization: plots (with matplotlib), overlays on the footage (with OpenCV), 3-D scenes."""

from catfree.viz._heat_map import (
    HeatMap as HeatMap,
    heat_map as heat_map,
    write_heat_map as write_heat_map,
)
from catfree.viz.footage._ground_grid import draw_ground_grid as draw_ground_grid
from catfree.viz.footage._overlay import (
    draw_frame as draw_frame,
    write_overlay_video as write_overlay_video,
)
from catfree.viz.plots._bird_eye import plot_bird_eye as plot_bird_eye
from catfree.viz.plots._coverage_map import plot_coverage as plot_coverage
from catfree.viz.plots._heat_map_plot import plot_heat_map as plot_heat_map
from catfree.viz.plots._threshold_plot import plot_gates as plot_gates
from catfree.viz.scene3d._scene_export import write_glb as write_glb, write_rerun as write_rerun
