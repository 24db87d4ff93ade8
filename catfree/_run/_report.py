"""The report of a run: a player, warnings, results, reliability and settings."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from catfree._coverage import Coverage
from catfree._run._run import RunOutcome
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.calibration.people import Calibration
from catfree.settings import Settings
from catfree.types import Localization, Origin, Reliability, Scene
from catfree.viz.page._blocks import (
    Block,
    Folded,
    Heading,
    Notice,
    Paragraph,
    Picture,
    Table,
    Verdicts,
    Video,
    write_blocks,
)
from catfree.viz.page._player import Player

LEAST_MODA = 50.0  # percent; below it, misses and false positives exceed half of the people
LEAST_COVERED = 0.5  # share of the area; the median uncertainty is known only above it
LEAST_BOXES_USED = 0.5  # rigs with swapped or unsynchronized cameras explain far fewer boxes

# Labels of the fields of `Thresholds`.
THRESHOLD_NAMES = {
    "tau_sigma": "threshold on sigma (scene units)",
    "tau_g": "threshold on the distance from the ground (scene units)",
    "tau_sigma_recovery": "threshold on sigma of recovered positions (scene units)",
    "tau_g_recovery": "threshold on the distance of recovered positions from the ground",
    "median_box_height": "median height of a box (px)",
    "pose_ratio": "weight of boxes without confirmed ankles",
    "extension_appearance": "largest appearance distance of an extension",
}


def write_report(
    root: Path,
    outcome: RunOutcome,
    settings: Settings,
    files: Sequence[Path],
    pictures: Sequence[Path],
    *,
    player: Player | None,
    covered: Coverage | None,
    video: Path | None,
    extra: Sequence[Block],
) -> list[Path]:
    """Write `report.md` and `report.html`.

    Args:
        root: the result folder, which must exist.
        outcome: what `run_stages` returned.
        settings: the settings of the run.
        files: other files of the folder, to be listed.
        pictures: pictures of the folder, to be shown.
        player: the player of the page, or None.
        covered: the ground that the cameras see, or None.
        video: the overlay video in the folder, or None.
        extra: further blocks, shown after the checks.

    Returns:
        The two files.
    """
    blocks: list[Block] = [Heading("catfree report", 1), *describe_warnings(outcome.warnings)]
    blocks += [] if player is None else [player]
    blocks += [*describe_acceptance(outcome, covered), *extra]
    blocks += describe_result(outcome)
    blocks += [
        Picture(path.relative_to(root).as_posix(), path.stem.replace("_", " ")) for path in pictures
    ]
    if video is not None:
        blocks += [Heading("Overlay"), Video(video.name, "all cameras and the plan")]
    if outcome.videos is not None:
        blocks += describe_footage(outcome.videos)
    blocks += describe_cameras(outcome, settings.calibration.person_height)
    blocks += describe_reliability(outcome.localization, outcome.scene)
    blocks += describe_settings(settings)
    shown = files if video is None else [*files, video]
    listed = (f"`{path.relative_to(root).as_posix()}`" for path in shown)
    blocks += [Heading("Files"), Paragraph(", ".join(listed) + ".")]
    return write_blocks(root, blocks)


def describe_warnings(warnings: Sequence[str]) -> list[Block]:
    """Show the warnings in a frame; return no block if there are none."""
    return [Notice("Warnings", tuple(warnings))] if warnings else []


def describe_acceptance(outcome: RunOutcome, covered: Coverage | None = None) -> list[Block]:
    """Show verdicts on cameras, coverage and positions that need no labels.

    Args:
        outcome: what `run_stages` returned.
        covered: the ground that the cameras see; None for no verdict on it.
    """
    reliability, rig = outcome.localization.reliability, outcome.scene.rig
    warned = len(outcome.warnings)
    registered, count = int(rig.registered.sum()), rig.camera_count
    rows: list[tuple[str, str, bool | None]] = [
        ("every camera has a place", f"{registered} of {count}", registered == count),
        (
            "the input raised no warning",
            f"{warned} warning{'s' * (warned > 1)}" if warned else "none",
            not warned,
        ),
    ]
    if covered is not None:
        share = covered.covered
        value = f"{100 * share:.0f} % of the area between the cameras"
        question = "two cameras see at least half of the ground"
        rows.append((question, value, share >= LEAST_COVERED))
    used, ratio = reliability.detections_used, reliability.sigma_over_radius
    rows.append(
        _verdict("most boxes support a position", used, used >= LEAST_BOXES_USED, 100.0, "%")
    )
    question = "the median sigma is below the radius of a correct position"
    rows.append(_verdict(question, ratio, ratio <= 1, 1.0, "of the radius"))
    low, expected = reliability.moda_low, reliability.expected_moda
    value, passed = "unknown", None
    if expected is not None and low is not None and np.isfinite([expected, low]).all():
        value, passed = f"{expected:.0f}, at least {low:.0f}", bool(low >= LEAST_MODA)
    rows.append((f"MODA is expected to be at least {LEAST_MODA:.0f}", value, passed))
    return [Heading("Acceptance"), Verdicts(tuple(rows))]


def _verdict(
    question: str, value: float, passed: bool | np.bool_, factor: float, unit: str
) -> tuple[str, str, bool | None]:
    """Make a row of `Verdicts`, unknown where the value is NaN for lack of positions."""
    if not np.isfinite(value):
        return question, "nobody found", None
    return question, f"{factor * value:.3g} {unit}", bool(passed)


def describe_footage(videos: SynchronizedVideos) -> list[Block]:
    """Show the videos and, if the frames have times, the time of frame 0."""
    blocks: list[Block] = [Heading("Footage"), footage_table(videos)]
    clock = videos.clock
    if clock is not None:
        zero = clock.describe() if clock.utc else f"{clock.start:.3f} s"
        blocks.append(
            Paragraph(f"Frame 0 is at {zero}, and there are {clock.frame_rate:.6g} per second.")
        )
    return blocks


def footage_table(videos: SynchronizedVideos) -> Table:
    """Tabulate length, frame rate, size, unused and dropped frames of each video."""
    rows = []
    for video in videos.footage:
        rate = "" if video.fps is None else f"{video.fps:.4g}"
        seconds = "" if video.seconds is None else f"{video.seconds:.1f}"
        size = f"{video.image_size[0]} x {video.image_size[1]}"
        unused = str(video.frame_count - video.pictures)
        row = (video.name, str(video.frame_count), rate, seconds, size, unused, str(video.dropped))
        rows.append(row)
    header = ("camera", "frames", "frames per second", "seconds", "size (px)", "frames not used")
    return Table((*header, "dropped frames"), tuple(rows))


def describe_result(outcome: RunOutcome) -> list[Block]:
    """Show the numbers of cameras, frames, detections, tracks and positions."""
    tracks, frames = outcome.localization.tracks, outcome.frames
    people = len(np.unique(tracks.track_id[tracks.track_id >= 0]))
    per_frame = len(tracks) / len(frames) if len(frames) else 0.0
    unit = "meters" if outcome.scene.metric else "scene units of unknown size"
    rows = (
        ("cameras", f"{int(outcome.scene.rig.registered.sum())} of {len(outcome.camera_names)}"),
        ("frames", str(len(frames))),
        ("detections", str(len(outcome.detections))),
        ("tracks", str(people)),
        ("positions", f"{len(tracks)} ({per_frame:.1f} per frame)"),
        ("unit of length", unit),
    )
    return [Heading("Result"), Table(("", ""), rows)]


def describe_cameras(outcome: RunOutcome, person_height: float) -> list[Block]:
    """Describe the cameras and how well their poses are known.

    Args:
        outcome: what `run_stages` returned.
        person_height: mean person height in meters that the calibration assumed.
    """
    rig, calibration = outcome.scene.rig, outcome.calibration
    table = camera_table(outcome.scene, outcome.camera_names, calibration)
    blocks: list[Block] = [Heading("Cameras"), table]
    lost = [n for n, known in zip(outcome.camera_names, rig.registered, strict=True) if not known]
    if lost:
        blocks.append(
            Paragraph(
                f"Not registered, and ignored: {', '.join(lost)}. The evidence for the poses of "
                "these cameras was too weak: they share too few people with the others."
            )
        )
    if calibration is not None and calibration.anchors:
        blocks.append(
            Paragraph(
                "Cameras and ground were found from the people and from anchors. The standard "
                f"deviation of all lengths is {100 * calibration.scale_sd:.1f} %."
            )
        )
        blocks += [Paragraph(check.sentence) for check in calibration.anchors]
    elif calibration is not None:
        blocks.append(
            Paragraph(
                "Cameras and ground were found from the people alone, assuming an average height "
                f"of {person_height:.2f} m: if your people are 5 % taller, all lengths are 5 % too "
                "short. "
                f"The standard deviation of all lengths is {100 * calibration.scale_sd:.0f} % "
                "if they are adults; a known distance (anchors) reduces it, and makes it valid for "
                "any people."
            )
        )
    return blocks


def camera_table(
    scene: Scene, camera_names: Sequence[str], calibration: Calibration | None
) -> Table:
    """Tabulate height and focal length of each camera, with reliability for a rig from people."""
    rig = scene.rig
    height = np.asarray(scene.ground.signed_distance(np.asarray(rig.centers, np.float64)))
    header = ["camera", "height above ground", "focal length (px)"]
    if calibration is not None:
        header += ["agrees with the others (%)", "evidence", "center uncertainty (m)"]
    rows = []
    for camera, name in enumerate(camera_names):
        if not rig.registered[camera]:
            rows.append((name, "not registered", *[""] * (len(header) - 2)))
            continue
        row = [name, f"{height[camera]:.2f}", f"{float(rig.K[camera, 0, 0]):.0f}"]
        if calibration is not None:
            variance = np.trace(calibration.center_covariance[camera])
            row += [
                f"{100 * calibration.association_rate[camera]:.0f}",
                f"{calibration.log_likelihood_ratio[camera]:.0f}",
                f"{np.sqrt(max(variance, 0.0)):.2f}",
            ]
        rows.append(tuple(row))
    return Table(tuple(header), tuple(rows))


def describe_reliability(localization: Localization, scene: Scene) -> list[Block]:
    """Show the label-free summary, the thresholds and the fates of the candidates."""
    reliability, tracks = localization.reliability, localization.tracks
    unit = " m" if scene.metric else ""
    extended = float((tracks.origin != Origin.DETECTED).mean()) if len(tracks) else 0.0
    rows = [
        *_expected_rows(reliability),
        ("median sigma of a position", _formatted(reliability.median_sigma, ".3f", unit)),
        ("sigma over suppression radius", _formatted(reliability.sigma_over_radius, ".2f")),
        ("mean cameras per position", _formatted(reliability.mean_supporting_cameras, ".2f")),
        ("detections that support a position", f"{100 * reliability.detections_used:.0f} %"),
        ("positions added by the trajectories", f"{100 * extended:.1f} %"),
        ("accepted positions that were recovered", f"{100 * reliability.fraction_recovered:.1f} %"),
    ]
    if reliability.ground_height is not None:
        height = _formatted(reliability.ground_height, "+.3f", unit)
        rows.append(("where foot rays meet, above the ground", height))
    for name, value in vars(localization.thresholds).items():
        if value is not None:
            rows.append((THRESHOLD_NAMES[name], f"{value:.4g}"))
    fates = localization.candidates.count_by_fate()
    counted = tuple((n.replace("_", " "), str(c)) for n, c in fates.items() if c)
    blocks = [Heading("Reliability, without labels"), Table(("measure", "value"), tuple(rows))]
    if reliability.expected_moda is not None:
        blocks.append(
            Paragraph(
                "The expected MODA (at half a meter) is predicted from rows of this table by a fit "
                "to simulated worlds. It does not account for people without any box, nor for "
                "errors that all cameras share, such as a wrong scale."
            )
        )
    return [
        *blocks,
        Heading("Candidates", 3),
        Table(("fate", "number"), counted),
    ]


def _formatted(value: float, form: str, unit: str = "") -> str:
    """Format a number, which is NaN without positions."""
    return f"{value:{form}}{unit}" if np.isfinite(value) else "too few people"


def _expected_rows(reliability: Reliability) -> list[tuple[str, str]]:
    """Make rows of expected MODA, precision and recall, where available."""
    rows = []
    expected, low, high = reliability.expected_moda, reliability.moda_low, reliability.moda_high
    if expected is not None and low is not None and high is not None:
        known = f"{expected:.0f} (90 % interval {low:.0f} to {high:.0f})"
        phrases = [known if np.isfinite(expected) else "unknown", reliability.expectation_note]
        rows.append(("expected MODA", ": ".join(filter(None, phrases))))
    for name, value in (
        ("expected precision", reliability.expected_precision),
        ("expected recall", reliability.expected_recall),
    ):
        if value is not None and np.isfinite(value):
            rows.append((name, f"{100 * value:.0f} %"))
    return rows


def describe_settings(settings: Settings) -> list[Block]:
    """Show all settings of the run."""
    rows = tuple((name, str(value)) for name, value in _flat(dataclasses.asdict(settings)))
    return [Folded("Settings", (Table(("setting", "value"), rows),))]


def _flat(settings: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for name, value in settings.items():
        if isinstance(value, dict):
            rows += _flat(value, f"{prefix}{name}.")
        else:
            rows.append((prefix + name, value))
    return rows
