"""All figures in the README, as suites for `benchmarks.gate`.

A suite works on one sequence or one kind of simulated world: it localizes or calibrates once and
returns all resulting figures. Keys are the suite's name, a slash, and the figure's name.
"""

import dataclasses
import json
import re
import tempfile
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path

import numpy as np

import catfree as cf
from benchmarks import methods, refine, robustness, uncertainty
from benchmarks.calibration_parts import Recovered, recover
from benchmarks.paper import camera_removal
from benchmarks.paper.scoring import Score, score
from benchmarks.paper.sequences import Sequence, twin
from catfree.adapters import ReIdOnnx, SynchronizedVideos, YoloPoseOnnx, read_uniform_json
from catfree.cli._demo import run_demo
from catfree.geometry import fit_similarity
from catfree.synthetic import RigError, disturb
from examples.real_footage import score as score_footage

Figures = Mapping[str, float]
Measure = Callable[[Path | None], Figures]

METHODS = {"paper": cf.Settings.paper(), "evidence": cf.Settings()}
WILDTRACK = "wildtrack_0_715"
ROOMS = ("cmc1", "cmc3")
REAL = (WILDTRACK, *ROOMS, *(f"{name} FairMOT" for name in ROOMS))
MULTIVIEWX = ("multiviewx_demo10_yolo26x", "multiviewx_demo10_yolo26x OSNet")
SCENES = tuple(f"public_{name}" for name in ("gmvd8", "mvx6", "ring5", "uneven7"))
BARE = tuple(f"{name} (no embeddings)" for name in SCENES)
OFF = {"rotation_deg": 1.0, "centre": 0.3, "focal": 0.02}  # errors of WildTrack's disturbed rigs
TWIN_SEEDS = (0, 1, 2)
CAMPUS = "real/epfl_campus4"
TERRACE = "real/epfl_terrace"
MODELS = "../models"  # beside the data


@dataclasses.dataclass(frozen=True)
class Suite:
    """Figures that are measured together.

    Attributes:
        name: unique name, with which the key of each figure begins.
        measure: computes the figures by name from the data folder.
        needs: path that it reads in the data folder, or None.
        quick: whether it takes only seconds.
    """

    name: str
    measure: Measure
    needs: str | None = None
    quick: bool = False

    def missing(self, data: Path | None) -> str:
        """Say which data the suite lacks; "" if none."""
        if self.needs is None:
            return ""
        if data is None:
            return f"{self.needs} is needed and no data folder was found"
        return "" if (data / self.needs).exists() else f"{data} holds no {self.needs}"


def file_of(name: str) -> str:
    """Return the path of a sequence in the data folder, from its name in `methods.sequences`."""
    stem = name.split(" ")[0]
    return f"scenarios/{stem}" if stem.startswith("public_") else f"real/{stem}.json"


@cache
def _sequences(data: Path) -> dict[str, Sequence]:
    return {sequence.name: sequence for sequence in methods.sequences(data)}


def _sequence(data: Path | None, name: str) -> Sequence:
    assert data is not None
    return _sequences(data)[name]


# With the given rig.


def given(name: str, data: Path | None) -> Figures:
    """Run both methods with the given rig: the README's table "What to expect"."""
    sequence = _sequence(data, name)
    assert data is not None
    figures: dict[str, float] = {}
    for method, settings in METHODS.items():
        result = cf.localize(sequence.detections, sequence.scene, settings)
        found = score(result, sequence)
        figures |= _labelled(method, _scores(found))
        figures |= _labelled(method, _expectation(result, found.moda))
        area = tracked_area(data / file_of(name))
        if area is not None:
            within = score(result, dataclasses.replace(sequence, area=area), tracking=False)
            figures[f"{method} MODA in the tracked area"] = within.moda
        if method == "evidence":
            figures |= _honesty(uncertainty.judge(result.tracks, sequence))
    return figures


def tracked_area(path: Path) -> tuple[float, float, float, float] | None:
    """Read from the file's note in which part of a room people were annotated; None without one.

    The rooms contain people at desks beyond it, who are seen by all cameras but not annotated.
    """
    if not path.is_file():
        return None
    bound = r"(-?[\d.]+?)\.\.(-?[\d.]+)"
    note = json.loads(path.read_text(encoding="utf-8")).get("ground", "")
    found = re.search(rf"tracked area x {bound}, y {bound}", note)
    if found is None:
        return None
    left, right, bottom, top = map(float, found.groups())
    return (left, right, bottom, top)


def _scores(found: Score) -> Figures:
    figures = {"MODA": found.moda}
    if found.tracking is not None and found.hota is not None:
        figures |= {"IDF1": found.tracking.idf1, "HOTA": found.hota.hota}
    return figures


def _expectation(result: cf.Localization, moda: float) -> Figures:
    """Compare the MODA expected without labels with the measured one."""
    told = result.reliability
    if told.expected_moda is None or not np.isfinite(told.expected_moda):
        return {}
    assert told.moda_low is not None
    assert told.moda_high is not None
    return {"MODA inside the 90 % interval": told.moda_low <= moda <= told.moda_high}


def _honesty(found: uncertainty.Honesty) -> Figures:
    return {
        "inside the 95 % ellipse": 100 * found.ellipses.share,
        "calibration error of existence": found.existence.expected_calibration_error,
    }


def _labelled(label: str, figures: Figures) -> Figures:
    return {f"{label} {name}": value for name, value in figures.items()}


# From people alone.


def from_people(name: str, data: Path | None) -> Figures:
    """Calibrate from the boxes of a sequence: the README's table "From people alone"."""
    return _recovered(recover(_sequence(data, name)))


def _recovered(found: Recovered) -> Figures:
    if not len(found.center_error):
        return {"cameras": found.registered}
    return {
        "cameras": found.registered,
        "centre error, mean": found.center_error.mean(),
        "centre error, worst": found.center_error.max(),
        "scale": found.scale,
        "stated deviation": 100 * found.scale_sd,
        "MODA, similarity": found.moda_similarity,
        "MODA, rigid": found.moda_rigid,
    }


def refined(seed: int, names: tuple[str, ...], data: Path | None) -> Figures:
    """Disturb WildTrack's true rig, then refine it with each of these methods."""
    sequence = _sequence(data, WILDTRACK)
    scene, true_centers = sequence.scene, np.asarray(sequence.scene.rig.centers)
    wrong = dataclasses.replace(scene, rig=disturb(scene.rig, **OFF, seed=seed))
    figures = {"centre error before": refine.center_error(wrong, true_centers)}
    for method in names:
        found = cf.refine(sequence.detections, wrong, METHODS[method])
        figures[f"centre error, {method}"] = refine.center_error(found.scene, true_centers)
    return figures


def refined_scene(name: str, names: tuple[str, ...], data: Path | None) -> Figures:
    """Refine the given rig with each of these methods, then localize with it."""
    sequence = _sequence(data, name)
    figures: dict[str, float] = {}
    for method in names:
        settings = METHODS[method]
        scene = cf.refine(sequence.detections, sequence.scene, settings).scene
        found = score(cf.localize(sequence.detections, scene, settings), sequence, scene)
        figures |= _labelled(method, _scores(found))
    return figures


# Simulated worlds and few cameras.


def turned_cameras(layout: str, seed: int, data: Path | None) -> Figures:
    """Localize in a world with the usual rig and with cameras off by a degree."""
    figures: dict[str, float] = {}
    for label, error in (("usual rig", None), ("off by 1°", RigError(rotation_deg=1.0))):
        paper, evidence = robustness.modas(robustness.simulated(layout, seed, rig_error=error))
        figures |= {f"paper MODA, {label}": paper, f"evidence MODA, {label}": evidence}
    return figures


def honest_world(index: int, data: Path | None) -> Figures:
    """Check uncertainty and existence in one simulated world."""
    sequence = uncertainty.world(*uncertainty.WORLDS[index])
    tracks = cf.localize(sequence.detections, sequence.scene).tracks
    return _honesty(uncertainty.judge(tracks, sequence))


def two_of_wildtrack(data: Path | None) -> Figures:
    """Localize with WildTrack's first two cameras."""
    return _two([_sequence(data, WILDTRACK)])


def two_of_twins(data: Path | None) -> Figures:
    """Localize with the first two cameras of WildTrack's simulated twins."""
    return _two([twin("WildTrack", seed) for seed in TWIN_SEEDS])


def _two(sequences: list[Sequence]) -> Figures:
    scores = camera_removal.remove_cameras(sequences, 2).scores
    return {f"{method} MODA": found.moda for method, found in scores.items()}


def demo(seed: int, data: Path | None) -> Figures:
    """Run the demo: rendered videos through the whole pipeline."""
    with tempfile.TemporaryDirectory() as folder:
        _, (similarity, rigid) = run_demo(folder, seed, pictures=False)
    error = similarity.centre_error[np.isfinite(similarity.centre_error)]
    return {
        "cameras": len(error),
        "centre error, mean": error.mean(),
        "scale": similarity.scale,
        "MODA, similarity": similarity.detection.moda,
        "MODA, rigid": rigid.detection.moda,
        "IDF1": similarity.tracking.idf1,
        "HOTA": similarity.hota,
    }


def footage(networks: bool, data: Path | None) -> Figures:
    """Run every fifth frame of real 360 x 288 video, with the given rig and one from people."""
    assert data is not None
    truth = read_uniform_json(data / CAMPUS / "campus.json")
    paths = sorted((data / CAMPUS).glob("*.mp4"))
    detector = YoloPoseOnnx(data / MODELS / "yolo11n-pose.onnx") if networks else None
    embedder = ReIdOnnx(data / MODELS / "osnet_x0_25_msmt17.onnx") if networks else None
    figures = {}
    with tempfile.TemporaryDirectory() as cache:
        for rig, scene in (("given rig", truth.scene), ("from people", None)):
            videos = SynchronizedVideos(paths, stride=5)
            outcome = cf.run_stages(videos, detector, embedder, scene=scene, cache_dir=cache)
            found = score_footage(outcome, truth)
            figures |= {
                f"{rig}, MODA": found.moda,
                f"{rig}, recall": found.recall,
                f"{rig}, IDF1": found.idf1,
            }
            if scene is None:
                figures |= {
                    "cameras": int(np.isfinite(found.camera_error).sum()),
                    "centre error, worst": float(np.nanmax(found.camera_error)),
                    "scale": found.scale,
                }
    return figures


def terrace(data: Path | None) -> Figures:
    """Calibrate from the boxes of a 2012 detector on real video; people have no truth."""
    assert data is not None
    truth = read_uniform_json(data / TERRACE / "terrace1_boxes.json")
    scene = cf.calibrate(truth.detections, truth.rig.image_size).scene
    registered = scene.rig.registered
    centers, true_centers = (np.asarray(rig.centers) for rig in (scene.rig, truth.rig))
    onto_truth = fit_similarity(centers[registered], true_centers[registered])
    moved = np.asarray(onto_truth(centers[registered]))
    error = np.linalg.norm(moved - true_centers[registered], axis=-1)
    return {
        "cameras": int(registered.sum()),
        "centre error, mean": float(error.mean()),
        "centre error, worst": float(error.max()),
        "scale": 1 / float(onto_truth.scale),
    }


def _suites() -> list[Suite]:
    """Return all suites, cheap ones first."""
    suites = [
        Suite(f"turned cameras/{layout}", partial(turned_cameras, layout, seed), quick=index == 0)
        for index, (layout, seed) in enumerate(robustness.LAYOUTS)
    ]
    for name in (*MULTIVIEWX, *REAL, *SCENES, *BARE):
        quick = name not in (WILDTRACK, *SCENES[1:], *BARE[1:])
        suites.append(Suite(f"given rig/{name}", partial(given, name), file_of(name), quick))
    suites += [
        Suite(f"honesty/{layout} {seed}", partial(honest_world, index), quick=index < 3)
        for index, (layout, seed, _) in enumerate(uncertainty.WORLDS)
    ]
    suites += [
        Suite("two cameras/WildTrack", two_of_wildtrack, file_of(WILDTRACK)),
        Suite("two cameras/twins", two_of_twins),
    ]
    suites += [
        Suite(f"refined/WildTrack {seed}", partial(refined, seed, names), file_of(WILDTRACK))
        for seed, names in enumerate((tuple(METHODS), ("evidence",)))
    ]
    for name in (*SCENES, *BARE):
        # Without appearance, the paper's method groups different people, who cannot refine a rig.
        names = ("evidence",) if name in BARE else tuple(METHODS)
        suites.append(Suite(f"refined/{name}", partial(refined_scene, name, names), file_of(name)))
    suites += [
        Suite(f"from people/{name}", partial(from_people, name), file_of(name), name == "cmc1")
        for name in ("cmc1", "cmc3", "cmc3 FairMOT", *SCENES, WILDTRACK)
    ]
    suites += [
        Suite("footage/Campus", partial(footage, False), CAMPUS),
        Suite("footage/Campus, YOLO11n and OSNet", partial(footage, True), MODELS),
        Suite("footage/Terrace, boxes", terrace, TERRACE),
    ]
    return [*suites, Suite("demo/seed 0", partial(demo, 0))]


SUITES = _suites()
