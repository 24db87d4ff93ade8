"""Simulated scenes and real recordings of the research data, and scoring of results on them."""

from functools import cache
from pathlib import Path

import numpy as np

import catfree as cf
from catfree import Settings
from catfree.adapters import MultiViewSequence, read_scenario, read_uniform_json
from catfree.evaluation import crop, detection_metrics_in_area, tracking_metrics
from catfree.geometry import fit_similarity

SCENARIOS = ("uneven7", "mvx6", "gmvd8", "ring5")
PAPER = Settings.paper()
EVERYWHERE = (-np.inf, np.inf, -np.inf, np.inf)


def real_path(data: Path, name: str) -> Path:
    return data / "real" / f"{name}.json"


@cache
def sequence_of(data: Path, name: str, **options) -> MultiViewSequence:
    """Read a simulated scene or a real recording by name, with these options."""
    if name in SCENARIOS:
        return read_scenario(data / "scenarios" / f"public_{name}", **options)
    return read_uniform_json(real_path(data, name), **options)


def localize(sequence: MultiViewSequence, settings: Settings = PAPER) -> cf.Localization:
    assert sequence.scene is not None
    return cf.localize(sequence.detections, sequence.scene, settings)


@cache
def of_the_paper(data: Path, name: str, **options) -> cf.Localization:
    """Run the paper's method once for several tests."""
    return localize(sequence_of(data, name, **options))


def rows_in_metres(sequence: MultiViewSequence, found: cf.Localization) -> np.ndarray:
    """Return track rows, aligning the rig's centers with the true ones if it is not metric."""
    assert sequence.scene is not None
    position = found.tracks.position
    if sequence.true_centres is not None and not sequence.scene.metric:
        align = fit_similarity(np.asarray(sequence.scene.rig.centers), sequence.true_centres)
        position = np.asarray(align(position))
    return found.tracks.to_rows(position[:, :2])


def area_of(sequence: MultiViewSequence):
    """Return the annotated area, or everything if the data state none."""
    return EVERYWHERE if sequence.evaluation_area is None else sequence.evaluation_area


def moda(sequence: MultiViewSequence, found: cf.Localization, area=None) -> float:
    """Compute MODA at half a meter inside the area."""
    rows = rows_in_metres(sequence, found)
    area = area_of(sequence) if area is None else area
    truth, frames = sequence.ground_truth, sequence.frames
    return detection_metrics_in_area(truth, rows, area, frames).metrics.moda


def idf1(sequence: MultiViewSequence, found: cf.Localization) -> float:
    """Compute IDF1 at one meter inside the annotated area."""
    truth, rows = (
        crop(r, area_of(sequence)) for r in (sequence.ground_truth, rows_in_metres(sequence, found))
    )
    return tracking_metrics(truth, rows, sequence.frames).idf1
