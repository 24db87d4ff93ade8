"""The command that tracks while the cameras record."""

import contextlib
import io
import json
import sys
from collections.abc import Iterator
from pathlib import Path

from catfree._worker import postponed_interruption
from catfree.cli._inputs import Unit, open_scene
from catfree.cli._terminal import print_text, warn
from catfree.errors import InvalidInputError

ASIDE = {
    "error": "Line {line} is left out: {message}",
    "dropped": "A frame of camera {camera} at {time:.3f} s is left out: {reason}.",
    "silent": "Camera {camera} is silent at {time:.3f} s: no frame has come from it for long. "
    "Check that it runs, and that frames without people have lines, too.",
}


def watch(
    scene: Path,
    frame_rate: float,
    lag: float = 2.0,
    timeout: float = 0.0,
    provisional: bool = True,
    unit: Unit = "m",
) -> None:
    """Track people live: lines of boxes on standard input, of positions on standard output.

    A line is the JSON of a frame of one camera: {"camera": "north", "time": 12.25, "boxes":
    [[x1, y1, x2, y2]], "scores": [0.9]}. A frame without people needs a line, too.

    Args:
        scene: known cameras and ground (scene.json, or any calibration format).
        frame_rate: instants per second.
        lag: seconds after which positions are final.
        timeout: seconds, by the times in the lines, to wait for missing cameras after a newer
            instant began; a newer complete instant ends the wait.
        provisional: also write provisional positions, which later frames may correct.
        unit: length of one unit of a scene whose file does not state it.
    """
    from catfree.adapters.files._camera_names import plain_numbers
    from catfree.methods.online import Tracker
    from catfree.methods.online._watch import watch as records_of_lines

    known_scene, names = open_scene(scene, unit)
    tracker = Tracker(known_scene, lag=lag)
    names = names or plain_numbers(known_scene.rig.camera_count)
    records = records_of_lines(
        _standard_input(), tracker, names, frame_rate=frame_rate, timeout=timeout
    )
    for record in records:
        if record["type"] in ASIDE:
            warn([ASIDE[record["type"]].format(**record)])
        elif provisional or record["type"] != "provisional":
            print_text(json.dumps(record))


def _standard_input() -> Iterator[str]:
    """Yield lines until the end or an interruption, which makes all positions final.

    Raises:
        InvalidInputError: if standard input is closed.
    """
    if sys.stdin is None:  # `<&-`
        raise InvalidInputError("Standard input is closed. Pipe the lines of boxes into it.")
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(encoding="utf-8-sig", errors="replace")
    with contextlib.suppress(KeyboardInterrupt):
        for line in sys.stdin:
            with postponed_interruption():
                yield line
