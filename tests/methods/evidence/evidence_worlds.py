from dataclasses import replace

import jax
import numpy as np
import pytest

import catfree as cf
from catfree.methods.evidence._gaussian import Information
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._measurement import Measurements, start_noise
from catfree.methods.evidence.passes._observe_boxes import observe_boxes
from catfree.settings import EvidenceSettings

HEIGHT = 1.7
RULES = EvidenceSettings()


def make_rig(count=5, radius=9.0, height=3.0, focal=900.0, roll=0.0):
    """Place cameras on a circle around the origin, looking at its center; z up, in meters."""
    rotations, translations = [], []
    for i in range(count):
        angle = 2 * np.pi * i / count + 0.3
        center = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        forward = np.array([0, 0, 0.8]) - center
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        R = np.stack([right, down, forward])
        c, s = np.cos(roll), np.sin(roll)
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ R
        rotations.append(R)
        translations.append(-R @ center)
    K = np.array([[focal, 0, 639.5], [0, focal, 359.5], [0, 0, 1]])
    return cf.Rig(np.tile(K, (count, 1, 1)), rotations, translations, (1280, 720))


def make_scene(rig):
    return cf.Scene(rig, cf.Plane([0.0, 0.0, 1.0], 0.0), 18.0, metric=True)


def bare_boxes(frame, camera, table, **known):
    """Make uncut boxes in pinhole cameras, with only the given properties."""
    flags = np.ones((len(frame), 3), bool)
    none = np.zeros((0, 3, 3))
    unknown = {
        "row": np.arange(len(frame)), "frames": np.arange(len(table)), "frame": frame,
        "camera": camera, "box": np.ones((len(frame), 4)), "edges": np.ones((len(frame), 3)),
        "view": camera, "K": none, "R": none, "cut": ~flags,
        "ankles": flags[:, 0], "covered": np.zeros(len(frame)), "valid": flags[:, 0],
        "table": table, "embedding": None,
        "first": np.searchsorted(frame, np.arange(len(table) + 1)),
        "silent": np.zeros(table.shape[:2], bool),
    }  # fmt: skip
    return Boxes(**(unknown | known))


def measured(count, deviation):
    """Make measurements of boxes with known edge deviations only."""
    return Measurements(
        Information(np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros(count)),
        np.full((count, 3), float(deviation)), np.ones((count, 3), bool),
        np.zeros(count, int), np.ones(count, bool),
    )  # fmt: skip


def state_of_boxes(scene, camera, deviation, unit=HEIGHT, rules=RULES):
    """Make the state of one frame with boxes of known camera and deviation only."""
    count, boxes = scene.rig.camera_count, len(camera)
    none = cf.Detections(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 4)))
    state = observe_boxes(
        none, scene, unit, start_noise(count, rules), rules, frames=np.zeros(1, int)
    )
    bare = bare_boxes(np.zeros(boxes, int), camera, np.full((1, count, 1), -1))
    return replace(state, boxes=bare, measurements=measured(boxes, deviation))


def box_of(rig, camera, xy, height=HEIGHT):
    """Return the box of a thin upright person, or None if it is not inside the image."""
    K, R, t = (np.asarray(a)[camera] for a in (rig.K, rig.R, rig.t))
    points = np.array([[*xy, 0.0], [*xy, height]]) @ R.T + t
    if (points[:, 2] < 0.5).any():
        return None
    pixel = points @ K.T
    pixel = pixel[:, :2] / pixel[:, 2:]
    (uf, vf), (uh, vh) = pixel
    half = 0.2 * (vf - vh)
    box = np.array([(uf + uh) / 2 - half, vh, (uf + uh) / 2 + half, vf])
    inside = (box[:2] > 12).all() and box[2] < 1267 and box[3] < 707
    return box if inside else None


def walk(people=6, frames=12, seed=0, noise=0.01, recall=0.95, clutter=0.2, rig=None):
    """Simulate people who walk straight through the middle; return rows and detections."""
    rng = np.random.default_rng(seed)
    rig = make_rig() if rig is None else rig
    # Starting places that keep people separate.
    grid = np.stack(np.meshgrid([-3.0, 0.0, 3.0], [-2.4, 0.0, 2.4]), -1).reshape(-1, 2)
    start = rng.permutation(grid)[:people] + rng.uniform(-0.3, 0.3, (people, 2))
    velocity = rng.uniform(-0.12, 0.12, (people, 2))
    height = HEIGHT * (1 + 0.04 * rng.standard_normal(people))
    truth, rows = [], []
    for t in range(frames):
        for i in range(people):
            xy = start[i] + t * velocity[i]
            truth.append([t, i, *xy])
            for c in range(rig.camera_count):
                box = box_of(rig, c, xy, height[i])
                if box is None or rng.random() > recall:
                    continue
                h = box[3] - box[1]
                rows.append([t, c, *(box + noise * h * rng.standard_normal(4))])
        for c in range(rig.camera_count):
            for _ in range(rng.poisson(clutter)):
                u, v, h = rng.uniform(100, 1100), rng.uniform(100, 500), rng.uniform(60, 200)
                rows.append([t, c, u, v, u + 0.4 * h, v + h])
    rows = np.array(rows)
    detections = cf.Detections(rows[:, 0].astype(int), rows[:, 1].astype(int), rows[:, 2:])
    return np.array(truth), detections, make_scene(rig)


@pytest.fixture
def sixtyfour():
    with jax.enable_x64(True):
        yield
