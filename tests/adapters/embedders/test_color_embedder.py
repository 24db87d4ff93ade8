import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.adapters import ColorEmbedder, Embedder

# Shirt, trousers and skin of distinguishable people.
CLOTHES = [
    [(200, 40, 40), (40, 50, 110), (210, 160, 130)],
    [(40, 60, 190), (60, 60, 60), (120, 80, 60)],
    [(60, 160, 70), (120, 90, 50), (210, 160, 130)],
    [(230, 200, 60), (40, 50, 110), (160, 110, 80)],
    [(225, 225, 225), (40, 40, 45), (210, 160, 130)],
    [(50, 50, 55), (190, 180, 160), (120, 80, 60)],
    [(150, 60, 160), (90, 90, 95), (210, 160, 130)],
]


def portrait(clothes, rng, *, gain=1.0, shift=(0, 0), height=120, tint=(1, 1, 1)):
    """Draw one person in front of a gray wall; also return the person's box."""
    shirt, trousers, skin = (np.array(c, float) for c in clothes)
    image = np.full((height + 40, height, 3), 150.0) + rng.normal(0, 12, (height + 40, height, 1))
    x, y, h = height / 2 + shift[0] * height, 20 + shift[1] * height, height

    def part(left, right, top, bottom, colour):
        rows = slice(int(y + top * h), int(y + bottom * h))
        image[rows, int(x + left * h) : int(x + right * h)] = colour

    part(-0.06, 0.06, 0, 0.16, skin)
    part(-0.15, 0.15, 0.16, 0.5, shirt)
    part(-0.11, -0.01, 0.5, 1, trousers)
    part(0.01, 0.11, 0.5, 1, trousers)
    noisy = image * gain * np.array(tint) + rng.normal(0, 4, image.shape)
    box = [height / 2 - 0.18 * h, 20, height / 2 + 0.18 * h, 20 + h]
    return np.clip(noisy, 0, 255).astype(np.uint8), box


def embed(index, rng, **changes):
    image, box = portrait(CLOTHES[index], rng, **changes)
    return ColorEmbedder()(image, [box])[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"gain": 0.6},
        {"gain": 1.1},
        {"shift": (0.03, 0.04)},
        {"height": 50},
        {"tint": (1.05, 1.0, 0.92)},
        {"gain": 0.7, "shift": (-0.03, -0.03), "height": 70},
    ],
)
def test_people_differ_more_than_one_persons_pictures(changes):
    rng = np.random.default_rng(0)
    first = np.array([embed(i, rng) for i in range(len(CLOTHES))])
    second = np.array([embed(i, rng, **changes) for i in range(len(CLOTHES))])
    distance = 1 - first @ second.T
    other = distance[~np.eye(len(CLOTHES), dtype=bool)]
    assert np.diag(distance).max() < 0.15
    assert other.min() > 1.5 * np.diag(distance).max()
    assert np.median(other) > 0.3
    np.testing.assert_array_equal(distance.argmin(axis=1), np.arange(len(CLOTHES)))


@given(st.floats(0.3, 1.0))
def test_exposure_hardly_matters(gain):
    """Return a picture, and the same picture with less light, without clipping or noise."""
    image, box = portrait(CLOTHES[3], np.random.default_rng(1))
    image = np.minimum(image, 240)
    darker = np.round(image * gain).astype(np.uint8)
    first, second = (ColorEmbedder()(picture, [box])[0] for picture in (image, darker))
    assert 1 - first @ second < 0.02


@given(
    st.lists(st.tuples(*[st.floats(-50, 150)] * 4), max_size=4),
    st.sampled_from([0, 128, 255, None]),
)
def test_rows_are_unit_vectors_whatever_the_box(boxes, grey):
    rng = np.random.default_rng(0)
    image = (
        rng.integers(0, 256, (60, 80, 3), np.uint8)
        if grey is None
        else np.full((60, 80, 3), grey, np.uint8)
    )
    vectors = ColorEmbedder()(image, np.array(boxes).reshape(-1, 4))
    assert vectors.shape == (len(boxes), 68)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, rtol=1e-5)


def test_it_is_an_embedder_and_order_does_not_matter():
    assert isinstance(ColorEmbedder(), Embedder)
    assert ColorEmbedder().fingerprint == ColorEmbedder().fingerprint
    image, box = portrait(CLOTHES[0], np.random.default_rng(0))
    boxes = np.array([box, np.add(box, 3), np.add(box, -4)])
    together = ColorEmbedder()(image, boxes)
    np.testing.assert_array_equal(ColorEmbedder()(image, boxes[::-1]), together[::-1])
