import numpy as np
from hypothesis import given, strategies as st

from catfree.adapters.onnx._letterbox import GRAY, Letterbox

sides = st.integers(1, 700)
sizes = st.tuples(sides, sides)
targets = st.tuples(
    st.integers(1, 24).map(lambda n: 32 * n), st.integers(1, 24).map(lambda n: 32 * n)
)
placements = st.sampled_from(["center", "top_left"])


@given(sizes, targets, placements)
def test_the_picture_fits_and_fills_one_side(size, target, placement):
    fit = Letterbox.fit(size, target, placement=placement)
    assert all(1 <= s <= t for s, t in zip(fit.size, target, strict=True))
    assert any(s == t for s, t in zip(fit.size, target, strict=True))
    assert all(p >= 0 and p + s <= t for p, s, t in zip(fit.pad, fit.size, target, strict=True))


@given(sizes, targets, placements)
def test_corners_map_back_exactly(size, target, placement):
    fit = Letterbox.fit(size, target, placement=placement)
    corners = np.array([fit.pad, np.add(fit.pad, fit.size)], float)
    np.testing.assert_allclose(fit.to_original(corners), [[0, 0], size], atol=1e-9 * max(size))


@given(sizes, targets, placements, st.floats(10, 5000), st.floats(-0.5, 1.5), st.floats(0.3, 9))
def test_intrinsics_project_to_the_mapped_pixel(size, target, placement, focal, shift, depth):
    fit = Letterbox.fit(size, target, placement=placement)
    K = np.array([[focal, 0, target[0] * shift], [0, 0.9 * focal, target[1] / 2], [0, 0, 1]])
    point = np.array([0.3, -0.2, 1]) * depth
    in_input, in_original = K @ point / depth, fit.intrinsics_to_original(K) @ point / depth
    scale = np.abs(in_original).max()
    np.testing.assert_allclose(fit.to_original(in_input[:2]), in_original[:2], atol=1e-9 * scale)


@given(st.integers(1, 90), st.integers(1, 90), placements)
def test_padding_is_grey_and_the_rest_shows_the_picture(width, height, placement):
    image = np.full((height, width, 3), 250, np.uint8)
    fit = Letterbox.fit((width, height), (64, 96), placement=placement)
    out = fit.apply(image, (64, 96))
    shown = np.zeros((96, 64), bool)
    shown[fit.inside((64, 96))] = True
    assert shown.sum() == fit.size[0] * fit.size[1]
    assert (out[shown] == 250).all()
    assert (out[~shown] == GRAY).all()


def test_cropping_keeps_the_middle():
    image = np.arange(100, dtype=np.uint8).reshape(10, 10, 1).repeat(3, axis=2)
    place = Letterbox.place((10, 10), (10, 10), (4, 14))
    out = place.apply(image, (4, 14), fill=255)
    np.testing.assert_array_equal(out[2:12], image[:, 3:7])
    assert (out[[0, 1, 12, 13]] == 255).all()
    np.testing.assert_array_equal(place.to_original(np.array([0.0, 2.0])), [3, 0])
