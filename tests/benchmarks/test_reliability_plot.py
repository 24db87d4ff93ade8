import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

from matplotlib import pyplot

from benchmarks.reliability_plot import plot_ellipse_coverage, plot_reliability
from catfree.evaluation import EllipseCoverage, calibration_curve


@pytest.fixture(autouse=True)
def no_open_figures():
    yield
    pyplot.close("all")


def test_every_filled_bin_is_a_dot_at_its_claim_and_outcome():
    rng = np.random.default_rng(0)
    claimed = rng.beta(0.5, 0.3, 500)
    curve = calibration_curve(claimed, rng.random(500) < claimed)
    ax = plot_reliability(curve)
    ax.figure.canvas.draw()
    dots = np.asarray(ax.collections[0].get_offsets())
    there = curve.count > 0
    np.testing.assert_allclose(
        dots, np.column_stack([curve.mean_probability, curve.observed_frequency])[there]
    )
    assert {text.get_text() for text in ax.texts} == {str(n) for n in curve.count[there]}
    sizes = ax.collections[0].get_sizes()
    assert np.argmax(sizes) == np.argmax(curve.count[there])
    assert f"{curve.expected_calibration_error:.3f}" in ax.get_title()


def test_honest_ellipses_lie_on_the_diagonal_and_small_ones_below():
    squared = np.random.default_rng(1).chisquare(2, 4000)
    ax = plot_ellipse_coverage(
        {"honest": EllipseCoverage(0.95, squared), "too small": EllipseCoverage(0.95, 4 * squared)}
    )
    ax.figure.canvas.draw()
    honest, small = (np.asarray(line.get_xydata()) for line in ax.lines[1:])
    assert np.abs(honest[:, 0] - honest[:, 1]).max() < 0.03
    assert (small[1:-1, 1] < small[1:-1, 0]).mean() > 0.95
    legend = ax.get_legend()
    assert legend is not None
    assert legend.get_texts()[0].get_text().startswith("honest: 95 %")


def test_nothing_to_judge_is_an_empty_picture():
    figure, (left, right) = pyplot.subplots(1, 2)
    assert plot_reliability(calibration_curve(np.zeros(0), np.zeros(0)), ax=left) is left
    empty = EllipseCoverage(0.95, np.zeros(0))
    assert plot_ellipse_coverage({"nobody": empty}, ax=right) is right
    figure.canvas.draw()
