"""The MODA expected without labels: laws and worked examples."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

import catfree as cf

# `benchmarks` is not an installed package, so import it from the checkout's root.
from benchmarks import fit_reliability
from catfree._run._cache import from_arrays, to_arrays
from catfree._run._report import describe_reliability
from catfree.geometry import Similarity, transform_scene
from catfree.methods._expectation import DOUBTED, FARTHEST, expect_moda
from catfree.methods._expectation_fits import FITS, Fit, Term
from catfree.methods.evidence._gaussian import probability_within
from catfree.synthetic import make_world
from catfree.types import Localization, Reliability
from catfree.types._archive import load_arrays, save_arrays
from catfree.viz.page._blocks import to_markdown

SUMMARY = Reliability(
    median_sigma=0.2,
    sigma_over_radius=0.5,
    fraction_recovered=0.4,
    fraction_extended=0.1,
    mean_supporting_cameras=3.2,
    detections_used=0.5,
    expected_precision=0.97,
    expected_recall=0.9,
)
MADE = Fit(
    settings=cf.Settings.paper(),
    intercept=20.0,
    terms=(
        Term("detections_used", False, 100.0, 0.2, 0.8),
        Term("sigma_over_radius", True, -10.0, 0.25, 1.0),
    ),
    below=12.0,
    above=9.0,
    worlds=100,
    error=6.0,
    correlation=0.9,
)
PAPER = cf.Settings.paper()


def made(used=0.5, sigma=0.5):
    summary = dataclasses.replace(SUMMARY, detections_used=used, sigma_over_radius=sigma)
    return expect_moda(summary, PAPER, fits=(MADE,))


@pytest.fixture(scope="module")
def world():
    return make_world("ring5", 2, frames=12, people=8)


@pytest.fixture(scope="module")
def found(world):
    return cf.localize(world.detections, world.scene, PAPER)


@pytest.mark.slow
def test_the_expectation_is_the_linear_function():
    found = made(0.5, 0.5)
    assert found.expected_moda == pytest.approx(20 + 50 - 10 * math.log(0.5))
    assert found.moda_low == pytest.approx(found.expected_moda - 12)
    assert found.moda_high == pytest.approx(found.expected_moda + 9)
    assert found.expectation_note is None


@pytest.mark.slow
@given(
    used=st.floats(-0.5, 1.5),
    sigma=st.floats(0.01, 10.0),
    step=st.floats(0.0, 0.2),
)
def test_the_interval_holds_the_expectation_and_nothing_exceeds_100(used, sigma, step):
    found = made(used, sigma)
    if math.isnan(found.expected_moda):
        assert math.isnan(found.moda_low)
        assert math.isnan(found.moda_high)
        assert found.expectation_note
        return
    assert found.moda_low <= found.expected_moda <= found.moda_high <= 100
    worse = made(used, sigma * (1 + step))
    assert math.isnan(worse.expected_moda) or worse.expected_moda <= found.expected_moda + 1e-9


@pytest.mark.slow
@given(excess=st.floats(0.0, 0.95 * FARTHEST * 0.6))
def test_outside_of_the_range_the_interval_widens_by_the_continuation(excess):
    border, beyond = made(0.2), made(0.2 - excess)
    assert beyond.expected_moda == pytest.approx(border.expected_moda - 100 * excess)
    assert beyond.moda_high == pytest.approx(border.moda_high)
    assert beyond.moda_low == pytest.approx(border.moda_low - 200 * excess)
    assert (beyond.expectation_note is None) == (0.2 - excess == 0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("used", "sigma"), [(1.2, 0.5), (0.5, 3.0), (math.nan, 0.5), (0.5, 0.0)])
def test_far_outside_nothing_is_said_and_the_note_names_the_number(used, sigma):
    found = made(used, sigma)
    assert math.isnan(found.expected_moda)
    name = "sigma over radius" if used == 0.5 else "detections used"
    assert name in found.expectation_note


@pytest.mark.slow
def test_other_settings_have_no_expectation():
    other = dataclasses.replace(PAPER, trajectories=cf.settings.TrajectorySettings(enabled=False))
    found = expect_moda(SUMMARY, other, fits=(MADE,))
    assert math.isnan(found.expected_moda)
    assert "Settings.paper()" in found.expectation_note
    assert "this one has trajectories.enabled=False." in found.expectation_note
    calibration = cf.settings.CalibrationSettings(person_height=1.6)
    same = dataclasses.replace(PAPER, calibration=calibration)
    assert expect_moda(SUMMARY, same, fits=(MADE,)).expected_moda == made().expected_moda


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bend", "shift", "together", "contradicted"),
    [(None, None, None, False), (0.01, 0.4, 1.0, False), (0.0, 0.4, math.nan, False),
     (0.0, 0.6, 1.0, True), (0.0, 0.05, 0.2, True), (0.04, 0.05, 1.0, True)],
)  # fmt: skip
def test_little_is_expected_of_cameras_that_the_boxes_contradict(
    bend, shift, together, contradicted
):
    plain = expect_moda(SUMMARY, cf.Settings.paper())
    summary = dataclasses.replace(
        SUMMARY, lens_bend=bend, shift_over_radius=shift, least_together=together
    )
    found = expect_moda(summary, cf.Settings.paper())
    if contradicted:
        assert found.moda_low <= 0
        assert found.expected_moda <= DOUBTED
        assert found.moda_high == plain.moda_high
        assert "contradict" in found.expectation_note
    else:
        assert found.expected_moda == plain.expected_moda
        assert found.expectation_note == plain.expectation_note


@pytest.mark.slow
@pytest.mark.parametrize(("deviation", "doubted"), [(None, False), (0.4, False), (0.6, True)])
def test_little_is_expected_of_cameras_that_few_people_showed(deviation, doubted):
    plain = expect_moda(SUMMARY, cf.Settings.paper())
    summary = dataclasses.replace(SUMMARY, rig_sd_over_radius=deviation)
    found = expect_moda(summary, cf.Settings.paper())
    assert (found.expected_moda <= DOUBTED < plain.expected_moda) == doubted
    assert found.moda_high == plain.moda_high
    assert ("Record longer" in (found.expectation_note or "")) == doubted


def test_no_position_is_a_moda_of_zero():
    found = expect_moda(SUMMARY, PAPER, positions=0)
    assert (found.expected_moda, found.moda_low, found.moda_high) == (0, 0, 0)
    nothing = cf.Detections(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 4)))
    scene = make_world("ring4", 0, frames=2, people=3).scene
    assert cf.localize(nothing, scene).reliability.expected_moda == 0


@pytest.mark.slow
def test_both_methods_are_fitted_and_larger_sigma_never_promises_more():
    assert [fit.settings for fit in FITS] == [cf.Settings.paper(), cf.Settings()]
    paper, evidence = ({term.name: term for term in fit.terms} for fit in FITS)
    assert paper["sigma_over_radius"].slope < 0
    assert paper["detections_used"].slope > 0
    assert evidence["sigma_over_radius"].slope < 0
    assert evidence["expected_recall"].slope > 0
    for fit in FITS:
        assert fit.worlds >= 80
        assert 0 < fit.error < 15
        assert fit.correlation > 0.75
        assert all(term.low < term.high for term in fit.terms)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2.0, 4.0])
def test_vaguer_positions_are_expected_to_be_right_less_often(factor):
    """The expected precision falls with sigma, other things being equal."""
    radius = cf.Settings().evidence.report_radius
    covariance = np.array([[[0.01, 0.002], [0.002, 0.02]]])
    sharp = probability_within(covariance, radius)
    vague = probability_within(factor * covariance, radius)
    assert vague < sharp
    isotropic = probability_within(0.02 * np.eye(2)[None], radius)
    assert isotropic[0] == pytest.approx(1 - math.exp(-(radius**2) / 0.04))


@pytest.mark.slow
def test_a_similarity_of_the_scene_changes_nothing(world, found):
    move = Similarity(
        7.3, np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([3.0, -2.0, 5.0])
    )
    moved = cf.localize(world.detections, transform_scene(move, world.scene), PAPER)
    before, after = found.reliability, moved.reliability
    assert after.expected_moda == pytest.approx(before.expected_moda, abs=0.5)
    assert after.moda_low == pytest.approx(before.moda_low, abs=0.5)


@pytest.mark.slow
def test_the_order_of_detections_changes_nothing(world, found):
    order = np.random.default_rng(0).permutation(len(world.detections))
    shuffled = cf.localize(world.detections[order], world.scene, PAPER)
    assert shuffled.reliability.expected_moda == found.reliability.expected_moda


@pytest.mark.slow
def test_results_of_earlier_versions_load(found, tmp_path):
    arrays = to_arrays(found)
    assert from_arrays(Localization, arrays).reliability == found.reliability
    new = ("expected_precision", "expected_recall", "expected_moda", "moda_low", "moda_high",
           "expectation_note")  # fmt: skip
    earlier = {name: a for name, a in arrays.items() if name.split(".")[-1] not in new}
    save_arrays(tmp_path / "old.npz", "Localization", earlier)
    stored = load_arrays(tmp_path / "old.npz", "Localization", required=None)
    read = from_arrays(Localization, stored)
    assert read.reliability.expected_moda is None
    assert read.reliability.median_sigma == found.reliability.median_sigma
    to_markdown(describe_reliability(read, make_world("ring4", 0, frames=2, people=2).scene))


@pytest.mark.slow
def test_the_report_says_what_to_expect(world, found):
    said = to_markdown(describe_reliability(found, world.scene))
    assert f"expected MODA | {found.reliability.expected_moda:.0f} (90 %" in said
    unknown = dataclasses.replace(
        found,
        reliability=expect_moda(
            dataclasses.replace(found.reliability, detections_used=math.nan), PAPER
        ),
    )
    assert "unknown: detections used is nan" in to_markdown(
        describe_reliability(unknown, world.scene)
    )


@pytest.mark.slow
def test_expected_rates_are_probabilities_and_only_the_evidence_method_has_them(world, found):
    assert found.reliability.expected_precision is None
    said = cf.localize(world.detections, world.scene).reliability
    assert 0.5 < said.expected_precision <= 1  # its reports are more likely right than wrong
    assert 0 < said.expected_recall <= 1
    assert said.moda_low <= said.expected_moda <= said.moda_high


@pytest.mark.slow
@given(seed=st.integers(0, 1000))
def test_the_fit_finds_the_function_that_made_the_rows(seed):
    rng = np.random.default_rng(seed)
    used, sigma = rng.uniform(0.1, 0.8, 60), rng.uniform(0.3, 1.0, 60)
    true = 30 + 60 * used - 20 * np.log(sigma) - 30
    rows = [
        {"number": n, "positions": 5, "detections_used": u, "sigma_over_radius": s, "moda": m}
        for n, (u, s, m) in enumerate(zip(used, sigma, true, strict=True))
    ]
    made = fit_reliability.fit("paper", rows)
    slopes = {term.name: term.slope for term in made.terms}
    assert made.intercept == pytest.approx(0, abs=1e-6)
    assert slopes["detections_used"] == pytest.approx(60)
    assert slopes["sigma_over_radius"] == pytest.approx(-20)
    assert made.error < 1e-6
    namespace = {"Fit": Fit, "Term": Term, "Settings": cf.Settings}
    exec(fit_reliability.source([made]), namespace)
    (read,) = namespace["FITS"]
    assert read.terms[0].slope == pytest.approx(60, abs=0.01)


@pytest.mark.slow
@given(seed=st.integers(0, 1000), count=st.integers(20, 400))
def test_margins_hold_the_stated_share_of_what_comes_next(seed, count):
    rng = np.random.default_rng(seed)
    low, high = fit_reliability.margins(rng.standard_normal(count))
    from scipy.stats import norm

    share = norm.cdf(high) - norm.cdf(-low)
    # The share is a random number with this spread around 90 %.
    assert share > 0.9 - 4.5 * math.sqrt(0.09 / count)
