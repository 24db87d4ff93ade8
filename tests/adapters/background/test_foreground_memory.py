"""A remembered foreground equals the one found before, and memory is bounded."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.adapters.background._background_model import BackgroundModel, Foreground
from catfree.adapters.background._foreground_memory import ForegroundMemory

ROWS, COLUMNS = 30, 41  # the pixels do not fill whole bytes


class Counting:
    """A background that counts how often it is asked."""

    def __init__(self, background):
        self.background, self.asked = background, 0

    def compare(self, picture):
        self.asked += 1
        return self.background.compare(picture)


@pytest.fixture(scope="module")
def background():
    rng = np.random.default_rng(0)
    scene = rng.integers(60, 200, (ROWS, COLUMNS, 3))
    pictures = scene + rng.integers(-2, 3, (9, ROWS, COLUMNS, 3))
    return BackgroundModel.estimate(list(pictures.astype(np.uint8)))


def picture_with_a_box(background, seed):
    rng = np.random.default_rng(seed)
    picture = np.moveaxis(background.scene, 0, -1).astype(np.uint8)
    x, y = rng.integers(0, COLUMNS - 12), rng.integers(0, ROWS - 16)
    picture[y : y + 16, x : x + 12] = rng.integers(0, 256, 3)
    return picture


@pytest.mark.slow
@given(st.integers(0, 2**16))
@settings(max_examples=25, deadline=None)
def test_what_is_remembered_is_what_was_found(background, seed):
    picture = picture_with_a_box(background, seed)
    counting = Counting(background)
    memory = ForegroundMemory(counting.compare)
    first, second = memory(picture), memory(picture.copy())
    truth: Foreground = background.compare(picture)
    assert counting.asked == 1
    for found in (first, second):
        np.testing.assert_array_equal(found.mask, truth.mask)
        np.testing.assert_array_equal(found.difference, truth.difference)
        assert (found.mask.dtype, found.difference.dtype) == (np.uint8, np.float32)


def test_a_changed_picture_is_another_one(background):
    memory = ForegroundMemory(background.compare)
    picture = picture_with_a_box(background, 0)
    before = memory(picture).mask.sum()
    picture[:] = np.moveaxis(background.scene, 0, -1).astype(np.uint8)
    assert before > 0
    assert memory(picture).mask.sum() == 0


def test_the_first_pictures_stay_and_the_rest_is_found_again(background):
    pictures = [picture_with_a_box(background, seed) for seed in range(6)]
    counting = Counting(background)
    memory = ForegroundMemory(
        counting.compare, limit=3 * 1000
    )  # 12 x 16 pixels of 4 bytes and a mask each
    for _ in range(2):
        for picture in pictures:
            found, truth = memory(picture), background.compare(picture)
            np.testing.assert_array_equal(found.difference, truth.difference)
    assert counting.asked == 6 + 3
