"""A stored result is accepted only if every column has its declared type."""

import dataclasses

import numpy as np
import pytest

from catfree._run._cache import StageCache, from_arrays, to_arrays
from catfree.errors import CatFreeError, InvalidInputError
from catfree.methods.paper._assemble import empty_localization
from catfree.types import Candidates, Localization, Reliability, Thresholds, Tracks
from catfree.types._archive import save_arrays
from catfree.types.results._localization import require_sound_localization
from catfree.types.results._tracks import require_sound_tracks


def tracks(count: int = 3) -> Tracks:
    return Tracks(
        frame=np.arange(count),
        track_id=np.zeros(count, np.int64),
        position=np.zeros((count, 3)),
        ground_xy=np.zeros((count, 2)),
        sigma=np.ones(count),
        covariance=np.tile(np.eye(2), (count, 1, 1)),
        supporting_cameras=np.full(count, 2),
        origin=np.zeros(count, np.int64),
        existence=np.full(count, 0.5),
    )


def stored() -> Localization:
    """Make a result with tracks, one known candidate, and one with only one ray."""
    candidates = Candidates(
        frame=np.arange(2),
        position=np.zeros((2, 3)),
        sigma=np.array([np.inf, 1.0]),
        ground_distance=np.array([np.nan, 0.0]),
        rms_angle=np.array([np.nan, 0.01]),
        support=np.full((2, 3), -1),
        score=np.zeros(2),
        fate=np.zeros(2, np.int64),
    )
    reliability = Reliability(
        median_sigma=1.0,
        sigma_over_radius=2.0,
        fraction_recovered=0.0,
        fraction_extended=0.0,
        mean_supporting_cameras=2.0,
        detections_used=0.5,
        expected_moda=80.0,
        moda_low=70.0,
        moda_high=90.0,
    )
    return Localization(tracks(), candidates, Thresholds(tau_g=1.0), reliability)


WRONG = {
    "NaN": {"position": np.full((3, 3), np.nan)},
    "infinite sigma of two cameras": {"sigma": np.array([1, np.inf, 1])},
    "negative sigma": {"sigma": np.array([1, -1.0, 1])},
    "complex": {"sigma": np.ones(3, complex)},
    "dates": {"frame": np.zeros(3, "datetime64[s]")},
    "bytes": {"ground_xy": np.zeros((3, 2), "S1")},
    "fractions of a frame": {"frame": np.zeros(3)},
    "a short column": {"track_id": np.zeros(2, np.int64)},
    "another shape": {"covariance": np.zeros((3, 3, 3))},
    "no probability": {"existence": np.array([0.0, 1.5, 1.0])},
    "an unknown origin": {"origin": np.array([0, 1, 99])},
    "an infinite velocity": {"velocity": np.array([[0, 0], [0, -np.inf], [0, 0]])},
    "half a velocity": {"velocity": np.array([[0, 0], [np.nan, 1], [0, 0]])},
    "a negative variance": {"covariance": np.tile(np.diag([1.0, -1.0]), (3, 1, 1))},
    "a negative variance of speed": {"velocity_covariance": np.tile(-np.eye(2), (3, 1, 1))},
    "more correlation than 1": {"covariance": np.tile([[1.0, 2], [2, 1]], (3, 1, 1))},
    "fewer than no cameras": {"supporting_cameras": np.array([2, -1, 2])},
    "a negative design": {"design_sigma": np.array([1, -1.0, 1])},
    "fewer than no views": {"whole_views": np.array([2, -5, 2])},
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_columns_are_named_wherever_they_are_read(what, tmp_path):
    require_sound_tracks(tracks())
    (name,) = WRONG[what]
    columns = vars(tracks()) | WRONG[what]
    save_arrays(tmp_path / "tracks.npz", "Tracks", columns)
    with pytest.raises(InvalidInputError, match=rf"tracks\.npz: {name}"):
        Tracks.load(tmp_path / "tracks.npz")
    whole = to_arrays(stored())
    assert from_arrays(Localization, whole).tracks.sigma.tolist() == [1, 1, 1]
    whole |= {f"tracks.{name}": value for name, value in WRONG[what].items()}
    with pytest.raises(CatFreeError, match=name):
        from_arrays(Localization, whole)
    cache = StageCache(tmp_path)
    save_arrays(cache.path("localize", "a"), "Localization", whole)
    assert cache.load("localize", "a", Localization) is None


def test_one_camera_may_not_know_how_sure_it_is():
    one = dataclasses.replace(
        tracks(),
        sigma=np.full(3, np.inf),
        covariance=np.full((3, 2, 2), np.inf),
        supporting_cameras=np.ones(3, np.int64),
    )
    require_sound_tracks(one)


def test_an_empty_result_is_sound():
    require_sound_localization(empty_localization(3))
    require_sound_localization(empty_localization(3, existence=True))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("reliability.median_sigma", np.inf),
        ("reliability.sigma_over_radius", np.inf),
        ("reliability.fraction_recovered", np.inf),
        ("reliability.mean_supporting_cameras", np.nan),
        ("reliability.expected_moda", np.inf),
        ("reliability.moda_high", np.nan),
        ("reliability.ground_height", -np.inf),
        ("reliability.shift_over_radius", np.nan),
        ("thresholds.tau_g", np.nan),
        ("thresholds.median_box_height", np.inf),
        ("thresholds.extension_appearance", np.nan),
        ("candidates.sigma", np.array([1, -1.0])),
        ("candidates.ground_distance", np.array([np.inf, 1.0])),
        ("candidates.rms_angle", np.array([1, np.nan])),
    ],
)
def test_only_what_may_be_unknown_is_not_finite(name, value):
    arrays = to_arrays(stored())
    require_sound_localization(from_arrays(Localization, arrays))
    with pytest.raises(InvalidInputError, match=name):
        from_arrays(Localization, arrays | {name: np.asarray(value)})


@pytest.mark.parametrize(
    "changes",
    [
        {"reliability.expected_moda": np.nan, "reliability.moda_low": np.nan},
        {"reliability.ground_height": np.nan, "reliability.least_together": np.nan},
        {"reliability.expected_precision": np.nan, "reliability.expected_recall": np.nan},
        {"thresholds.extension_appearance": np.inf},
        {"reliability.rig_sd_over_radius": 0.0},
    ],
)
def test_what_is_unknown_may_be_nan(changes):
    arrays = to_arrays(stored()) | {name: np.asarray(value) for name, value in changes.items()}
    require_sound_localization(from_arrays(Localization, arrays))


def test_the_median_of_unknown_sigmas_is_infinite():
    most = dataclasses.replace(
        tracks(),
        sigma=np.array([1, np.inf, np.inf]),
        supporting_cameras=np.array([2, 1, 1]),
    )
    summary = dataclasses.replace(stored().reliability, median_sigma=np.inf)
    summary = dataclasses.replace(summary, sigma_over_radius=np.inf)
    require_sound_localization(dataclasses.replace(stored(), tracks=most, reliability=summary))


def test_thresholds_are_numbers(tmp_path):
    arrays = to_arrays(empty_localization(3))
    for value in (np.array("x"), np.array(1j), np.zeros(2)):
        with pytest.raises(CatFreeError, match="tau_g"):
            from_arrays(Localization, arrays | {"thresholds.tau_g": value})
