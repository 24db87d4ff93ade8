"""The player of the report page: its data and its markup.

Plotly and Bokeh put 1 to 5 MB into each page and play no pictures in step with a plot, so the page
has a short script of its own.
"""

import html
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from jaxtyping import Int

from catfree._coverage import Coverage
from catfree.types import Clock, Detections, Localization, Origin, Scene, Tracks
from catfree.viz._palette import TRACK_COLORS, UNTRACKED
from catfree.viz._plan_view import camera_wedges, confidence_ellipse, length_unit, view_area
from catfree.viz.footage._drawing import round_step
from catfree.viz.page._excerpt import Excerpt, arrange

GRID_LINES = 8  # approximate number along the longer side
MOST_CELLS = 64  # of the map of coverage, along each side
RESOLUTION = 1e-4  # of a coordinate, as a share of the plan


@dataclass(frozen=True)
class Player:
    """The content of the player.

    Attributes:
        data: the document that `player.js` reads.
        caption: a sentence about it.
    """

    data: dict[str, Any]
    caption: str


def make_player(
    excerpt: Excerpt,
    detections: Detections,
    localization: Localization,
    scene: Scene,
    camera_names: Sequence[str],
    *,
    pictures: str | None = None,
    coverage: Coverage | None = None,
) -> Player:
    """Collect the content of the player.

    Args:
        excerpt: the instants.
        detections: person boxes of the run.
        localization: the result of `cf.localize` for them.
        scene: cameras and ground.
        camera_names: (C,) names.
        pictures: folder of the pictures, relative to the page; None without pictures.
        coverage: where two cameras see the ground, or None.
    """
    frames, tracks = excerpt.frames, localization.tracks
    view = view_area(scene, tracks.ground_xy)
    wedges = camera_wedges(scene)
    board = arrange(np.asarray(scene.rig.image_size))
    shown = tracks[np.isin(tracks.frame, frames)]
    shown = shown[np.argsort(shown.frame, kind="stable")]
    document = {
        "frames": frames.tolist(),
        "labels": _labels(frames, detections.clock or tracks.clock),
        "rate": excerpt.rate,
        "unit": length_unit(scene),
        "view": [float(side) for side in view],
        "grid": round_step(max(view[1] - view[0], view[3] - view[2]) / GRID_LINES),
        "colors": TRACK_COLORS,
        "untracked": UNTRACKED,
        "people": _people(shown, frames, RESOLUTION * max(view[1] - view[0], view[3] - view[2])),
        "boxes": _boxes(detections, localization.identity, frames),
        "board": board.size,
        "cameras": [
            {
                "name": str(name),
                "size": [int(side) for side in scene.rig.image_size[camera]],
                "tile": board.tiles[camera].tolist(),
                "wedge": wedges[camera].tolist() if camera in wedges else None,
            }
            for camera, name in enumerate(camera_names)
        ],
        "sheet": None if pictures is None else {"folder": pictures},
        "coverage": None if coverage is None else _covered(coverage),
    }
    return Player(document, _caption(excerpt, pictures))


def player_markup(player: Player) -> str:
    """Return the player as HTML: markup, data and script; `page.css` styles it."""
    last = len(player.data["frames"]) - 1
    layers = ["ellipses", "trails", "boxes"]
    layers += [] if player.data["coverage"] is None else ["coverage"]
    # The plan shows coverage only where it is known.
    boxes = "".join(
        f'<label><input type="checkbox" id="show-{name}" checked> {name}</label>' for name in layers
    )
    if "coverage" not in layers:
        boxes += '<input type="checkbox" id="show-coverage" hidden>'
    speeds = "".join(
        f'<option value="{speed}"{" selected" if speed == 1 else ""}>{speed}x</option>'
        for speed in (0.25, 0.5, 1, 2, 4)
    )
    data = json.dumps(player.data, separators=(",", ":"), allow_nan=False)
    # Neither `</script>` nor `<!--` may stand in a script element.
    data = data.replace("<", "\\u003c")
    return (
        '<section class="player" aria-label="Player"><div class="stage">'
        '<canvas id="plan" role="img" aria-label="Plan of the ground with cameras and people">'
        '</canvas><canvas id="views" role="img" aria-label="Pictures of the cameras"></canvas>'
        '</div><div class="controls"><button id="play" type="button">Play</button>'
        f'<input type="range" id="instant" min="0" max="{last}" value="0" step="1" '
        'aria-label="Instant"><span id="readout"></span>'
        f'<label>speed <select id="speed">{speeds}</select></label>{boxes}</div>'
        f'<p class="hint">{html.escape(player.caption)} Space plays, arrow keys step, 1 to 9 or a '
        "click enlarges a camera, 0 shows all. Ellipses hold a position with 95 % probability; "
        "hollow dots are positions without a box.</p></section>"
        f'<script type="application/json" id="player-data">{data}</script>'
        f"<script>{_resource('player.js')}</script>"
    )


def page_style() -> str:
    """Return the style sheet of the report page."""
    return _resource("page.css")


def _resource(name: str) -> str:
    return files("catfree.viz.page").joinpath(name).read_text(encoding="utf-8")


def _caption(excerpt: Excerpt, pictures: str | None) -> str:
    frames = excerpt.frames
    if len(frames) == excerpt.total:
        return "All instants of the run."
    pictured = "with pictures " if pictures is not None else ""
    return (
        f"{len(frames)} of {excerpt.total} instants {pictured}(frames {frames[0]} to "
        f"{frames[-1]}), where most people are."
    )


def _labels(frames: Int[np.ndarray, " t"], clock: Clock | None) -> list[str]:
    if clock is None:
        return [f"frame {frame}" for frame in frames]
    times = [
        Clock(clock.frame_rate, second, True).describe() if clock.utc else f"{second:.2f} s"
        for second in clock.seconds(frames)
    ]
    return [f"frame {frame} · {time}" for frame, time in zip(frames, times, strict=True)]


def _starts(frame: Int[np.ndarray, " m"], frames: Int[np.ndarray, " t"]) -> list[int]:
    """Find where each instant's rows begin, and where the last one's end; `frame` is sorted."""
    return [*np.searchsorted(frame, frames).tolist(), len(frame)]


def _people(tracks: Tracks, frames: Int[np.ndarray, " t"], resolution: float) -> dict[str, Any]:
    ellipses = np.zeros((len(tracks), 3))
    for row, covariance in enumerate(np.asarray(tracks.covariance, np.float64)):
        if np.isfinite(covariance).all():
            ellipses[row] = confidence_ellipse(covariance)
    lengths = np.column_stack([tracks.ground_xy, ellipses[:, :2]])
    digits = max(int(np.ceil(-np.log10(resolution))), 0)
    x, y, major, minor = lengths.T.round(digits).tolist()
    hollow = (np.asarray(tracks.origin) != Origin.DETECTED).astype(int).tolist()
    start = _starts(np.asarray(tracks.frame), frames)
    return {
        "start": start,
        "id": tracks.track_id.tolist(),
        "x": x,
        "y": y,
        "major": major,
        "minor": minor,
        "angle": ellipses[:, 2].round(3).tolist(),
        "hollow": hollow,
    }


def _boxes(
    detections: Detections, identity: Int[np.ndarray, " n"], frames: Int[np.ndarray, " t"]
) -> dict[str, Any]:
    chosen = np.flatnonzero(np.isin(detections.frame, frames))
    chosen = chosen[np.argsort(detections.frame[chosen], kind="stable")]
    return {
        "start": _starts(np.asarray(detections.frame)[chosen], frames),
        "camera": detections.camera[chosen].tolist(),
        "id": np.asarray(identity)[chosen].tolist(),
        "box": np.round(np.asarray(detections.box)[chosen], 1).ravel().tolist(),
    }


def _covered(coverage: Coverage) -> dict[str, Any]:
    """Find the cells of the ground that two cameras see, at a coarse resolution."""
    step = -(-max(coverage.cameras.shape) // MOST_CELLS)
    x_min, x_max, y_min, y_max = coverage.area
    height, width = coverage.cameras.shape
    cells = (coverage.cameras >= 2)[::step, ::step]
    return {
        "x": x_min,
        "y": y_min,
        "dx": (x_max - x_min) / width * step,
        "dy": (y_max - y_min) / height * step,
        "cells": ["".join("1" if covered else "0" for covered in row) for row in cells],
    }
