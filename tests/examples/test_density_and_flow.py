"""Density and flow of people who walk one behind the other, by PedPy."""

import sys

import numpy as np
import pytest

from catfree import Clock, Tracks
from catfree.adapters import write_tracks_csv

pytestmark = pytest.mark.slow

pytest.importorskip("pedpy", reason="PedPy is not installed")


def column_of_walkers(people=6, frames=60) -> Tracks:
    """Make people 2 m behind each other who walk along x at 1 m/s, at 10 frames per second."""
    frame = np.repeat(np.arange(frames), people)
    person = np.tile(np.arange(people), frames)
    xy = np.column_stack([0.1 * frame - 2.0 * person + 0.05, np.full(len(frame), 1.0)])
    n = len(frame)
    return Tracks(
        frame=frame,
        track_id=person,
        position=np.column_stack([xy, np.zeros(n)]),
        ground_xy=xy,
        sigma=np.full(n, 0.1),
        covariance=np.tile(0.01 * np.eye(2), (n, 1, 1)),
        supporting_cameras=np.full(n, 2),
        origin=np.zeros(n, int),
        clock=Clock(10),
    )


def test_pedpy_measures_what_was_walked(load_example, tmp_path, monkeypatch, capsys):
    example = load_example("density_and_flow")
    density, speed, flow = example.measure(column_of_walkers(), [-8, 2, 0, 2], [-2, 0, -2, 3])
    assert density == pytest.approx(5 / 20, rel=0.1)  # a person every 2 m of a strip 2 m wide
    assert speed == pytest.approx(1.0, rel=1e-6)
    assert flow == pytest.approx(0.5, rel=0.05)  # one every two seconds
    path = write_tracks_csv(tmp_path / "tracks.csv", column_of_walkers())
    words = ["--area", "-8", "2", "0", "2", "--line", "-2", "0", "-2", "3"]
    monkeypatch.setattr(sys, "argv", ["density_and_flow.py", str(path), *words])
    example.main()
    assert "speed 1.00 m/s" in capsys.readouterr().out
