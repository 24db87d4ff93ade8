"""A scene from videos: which pictures are reconstructed, and the result."""

import inspect

import cv2
import numpy as np
import pytest

import catfree.calibration
from catfree.adapters import SynchronizedVideos
from catfree.calibration.reconstructions._scene_from_videos import scene_from_videos
from catfree.errors import InvalidInputError
from catfree.geometry import fit_similarity
from catfree.synthetic import make_layout
from tests.noisy_reconstruction import reconstruct


class Noisy:
    """Noisy reconstructions of a rig and some points, recording the requested pictures."""

    fingerprint = "none"

    def __init__(self, rig, rng, points):
        self.rig, self.rng, self.points, self.seen = rig, rng, points, []

    def __call__(self, images):
        self.seen.append([int(image.flat[0]) for image in images])
        return reconstruct(self.rig, self.rng, rotation=0.002, center=0.02, points=self.points)


@pytest.mark.slow
def test_scene_from_videos_finds_rig_and_floor(tmp_path):
    folders = [tmp_path / f"camera{camera}" for camera in range(6)]
    for camera, folder in enumerate(folders):
        folder.mkdir()
        for frame in range(20):
            picture = np.full((108, 192, 3), 10 * frame + camera, np.uint8)
            cv2.imwrite(str(folder / f"{frame:03d}.png"), picture)
    rig, rng = make_layout("ring6", 0).rig, np.random.default_rng(7)
    floor = np.column_stack([rng.uniform(-8, 8, (800, 2)), rng.normal(0, 0.02, 800)])
    reconstructor = Noisy(rig, rng, floor)
    scene = scene_from_videos(SynchronizedVideos(folders), reconstructor, instants=5)
    # Synchronous pictures of all cameras, spread over the sequence.
    assert reconstructor.seen == [[10 * f + c for c in range(6)] for f in (2, 6, 10, 14, 18)]
    centers = np.asarray(scene.rig.centers)
    similarity = fit_similarity(centers, np.asarray(rig.centers))
    height = np.asarray(scene.ground.signed_distance(centers)) * float(similarity.scale)
    np.testing.assert_allclose(height, np.asarray(rig.centers)[:, 2], atol=0.15)


def test_the_name_that_callers_know():
    assert catfree.calibration.scene_from_videos is scene_from_videos


def test_a_reconstructor_that_returns_something_else_is_named(tmp_path):
    folders = [tmp_path / name for name in "ab"]
    for folder in folders:
        folder.mkdir()
        cv2.imwrite(str(folder / "0.png"), np.full((108, 192, 3), len(folder.name), np.uint8))
    rig = make_layout("ring6", 0).rig

    class Half(Noisy):
        def __call__(self, images):
            return self.rig

    videos, half = SynchronizedVideos(folders), Half(rig, None, None)
    with pytest.raises(InvalidInputError, match="What Half returns must be a Reconstruction"):
        scene_from_videos(videos, half, instants=1)
    unchecked = inspect.unwrap(scene_from_videos)  # bypass the tests' type checks
    for videos_given, reconstructor, instants, message in (
        (folders, half, 1, "videos must be a SynchronizedVideos, got list"),
        (videos, Half, 1, r"reconstructor is the class Half. Pass an instance of it: Half\(...\)"),
        (videos, half, 0, "instants is 0; it must be 1 or more"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            unchecked(videos_given, reconstructor, instants=instants)
