"""Measure how fast a browser loads the report page of a long run, and what it requests.

    python -m benchmarks.report_page --positions 10000

Needs Playwright and an installed Chromium.
"""

import argparse
import shutil
import tempfile
from pathlib import Path

import numpy as np

from catfree._coverage import coverage
from catfree._run._report import write_report
from catfree._run._run import RunOutcome
from catfree.methods.paper._assemble import empty_localization
from catfree.settings import Settings
from catfree.synthetic import make_world
from catfree.types import Clock, Detections, Localization, Tracks
from catfree.viz.page._excerpt import choose_excerpt
from catfree.viz.page._player import make_player

PEOPLE = 20
BUDGET = 2.0  # seconds


def long_run(positions: int) -> RunOutcome:
    """Make a run with that many positions of random walkers, without footage."""
    world = make_world("ring4", 0, frames=2, people=2)
    rng = np.random.default_rng(0)
    frames = -(-positions // PEOPLE)
    frame, person = np.divmod(np.arange(frames * PEOPLE), PEOPLE)
    steps = rng.normal(0, 0.1, (frames, PEOPLE, 2)).cumsum(0) + rng.uniform(-6, 6, (PEOPLE, 2))
    xy = steps[frame, person]
    count = len(frame)
    tracks = Tracks(
        frame, person, np.column_stack([xy, np.zeros(count)]), xy, np.full(count, 0.1),
        np.tile(np.diag([0.01, 0.02]), (count, 1, 1)), np.full(count, 3), np.zeros(count, int),
        clock=Clock(5.0),
    )  # fmt: skip
    corner = rng.uniform(0, 900, (4 * count, 2))
    boxes = Detections(
        np.tile(frame, 4), np.repeat(np.arange(4), count),
        np.concatenate([corner, corner + np.array([60, 150])], axis=1), clock=Clock(5.0),
    )  # fmt: skip
    blank = empty_localization(4)
    found = Localization(tracks, blank.candidates, blank.thresholds, blank.reliability, len(boxes))
    names = ("north", "east", "south", "west")
    return RunOutcome(found, boxes, world.true_scene, None, names, np.arange(frames))


def main() -> int:
    """Write the page, load it, and print the measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--positions", type=int, default=10_000)
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright

    outcome = long_run(options.positions)
    scene, tracks = outcome.scene, outcome.localization.tracks
    excerpt = choose_excerpt(outcome.frames, tracks.frame, 4, 5.0, pictured=False)
    covered = coverage(scene)
    player = make_player(
        excerpt,
        outcome.detections,
        outcome.localization,
        scene,
        outcome.camera_names,
        coverage=covered,
    )
    shown = player.data["people"]["start"][-1]
    browser_path = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        root = Path(folder)
        write_report(
            root, outcome, Settings(), [], [],
            player=player, covered=covered, video=None, extra=(),
        )  # fmt: skip
        page_file = root / "report.html"
        browser = driver.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
        requests: list[str] = []
        times = []
        for _ in range(5):
            page = browser.new_page()
            page.on("request", lambda request: requests.append(request.url))
            page.goto(page_file.as_uri())
            page.wait_for_function("document.getElementById('readout').textContent !== ''")
            times.append(
                page.evaluate("performance.getEntriesByType('navigation')[0].loadEventEnd")
            )
            page.close()
        size = page_file.stat().st_size
        browser.close()
    elsewhere = {url for url in requests if not url.startswith("file:")}
    seconds = float(np.median(times)) / 1000
    print(
        f"{shown} positions in {len(excerpt.frames)} instants: {size / 1e6:.2f} MB, loaded in "
        f"{seconds:.2f} s (median of 5, worst {max(times) / 1000:.2f} s), {len(elsewhere)} "
        "requests to a network"
    )
    return int(seconds > BUDGET or bool(elsewhere))


if __name__ == "__main__":
    raise SystemExit(main())
