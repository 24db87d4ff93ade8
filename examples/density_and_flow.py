"""Compute density and flow of pedestrians from tracks with PedPy.

    python examples/density_and_flow.py results --area 0 4 0 4 --line 2 0 2 4

`results` is a folder that `catfree run` or `catfree localize` wrote, in meters and with a clock
(`--frame-rate`), or a tracks.csv. Needs PedPy: pip install 'catfree[bridges]'.
"""

import argparse
import tempfile
from pathlib import Path

import pedpy

import catfree as cf


def measure(
    tracks: cf.Tracks, area: list[float], line: list[float], frame_rate: float | None = None
) -> tuple[float, float, float]:
    """Measure with PedPy.

    Args:
        tracks: in meters.
        area: x_min, x_max, y_min, y_max of the area whose density is measured.
        line: x1, y1, x2, y2 of the line across which the flow is measured.
        frame_rate: frames per second; None for the rate of the tracks' clock.

    Returns:
        Average people per square meter, average meters per second, and people per second who cross
        the line, from the first to the last.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = cf.adapters.write_pedpy(Path(folder) / "tracks.txt", tracks, frame_rate)
        walked = pedpy.load_trajectory(trajectory_file=path)
    x_min, x_max, y_min, y_max = area
    corners = [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]
    density = pedpy.compute_classic_density(
        traj_data=walked, measurement_area=pedpy.MeasurementArea(corners)
    )
    speed = pedpy.compute_individual_speed(
        traj_data=walked,
        frame_step=max(1, round(walked.frame_rate / 2)),
        speed_calculation=pedpy.SpeedCalculation.BORDER_SINGLE_SIDED,
    )
    ends = pedpy.MeasurementLine([tuple(line[:2]), tuple(line[2:])])
    counted, _ = pedpy.compute_n_t(traj_data=walked, measurement_line=ends)
    passed = counted[counted.cumulative_pedestrians > 0]
    crossed = int(counted.cumulative_pedestrians.max())
    duration = passed.time.loc[passed.cumulative_pedestrians == crossed].min() - passed.time.min()
    flow = (crossed - 1) / duration if crossed > 1 and duration > 0 else 0.0
    return float(density.density.mean()), float(speed.speed.mean()), float(flow)


def main() -> None:
    """Print density, speed and flow."""
    parser = argparse.ArgumentParser(description="Density and flow of pedestrians, by PedPy.")
    parser.add_argument("tracks", help="results folder or tracks.csv")
    parser.add_argument(
        "--area", nargs=4, type=float, required=True, help="x_min x_max y_min y_max"
    )
    parser.add_argument("--line", nargs=4, type=float, required=True, help="x1 y1 x2 y2")
    parser.add_argument("--frame-rate", type=float, help="if the tracks have no clock")
    options = parser.parse_args()
    tracks = cf.adapters.read_tracks(options.tracks)
    density, speed, flow = measure(tracks, options.area, options.line, options.frame_rate)
    print(f"density {density:.3f} people per square meter, speed {speed:.2f} m/s")
    print(f"flow {flow:.3f} people per second")


if __name__ == "__main__":
    main()
