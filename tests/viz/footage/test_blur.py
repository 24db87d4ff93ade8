"""What is blurred, and that it is no longer visible."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st

from catfree.viz import draw_frame
from catfree.viz.footage._blur import BLOCKS, blur_regions, people_regions

NOISE = np.random.default_rng(0).integers(0, 256, (120, 160, 3)).astype(np.uint8)


@given(
    box=st.tuples(
        st.integers(-50, 200), st.integers(-50, 200), st.integers(0, 90), st.integers(0, 90)
    )
)
def test_only_the_box_changes_and_any_box_is_allowed(box):
    x, y, width, height = box
    blurred = blur_regions(NOISE, np.array([[x, y, x + width, y + height]], float))
    border = int(np.ceil(0.15 * width)) + 2
    outside = np.ones(NOISE.shape[:2], bool)
    outside[max(y - border, 0) : max(y + height + border, 0)][
        :, max(x - border, 0) : max(x + width + border, 0)
    ] = False
    np.testing.assert_array_equal(blurred[outside], NOISE[outside])


def test_little_is_left_of_what_is_inside():
    inside = blur_regions(NOISE, np.array([[20.0, 10, 100, 110]]))[20:100, 30:90].astype(float)
    steps = np.abs(np.diff(inside, axis=1)).mean()
    assert steps < 0.1 * np.abs(np.diff(NOISE[20:100, 30:90].astype(float), axis=1)).mean()
    assert BLOCKS < 10
    np.testing.assert_array_equal(blur_regions(NOISE, np.zeros((0, 4))), NOISE)


@pytest.mark.slow
def test_boxes_and_tracked_people_without_a_box_are_blurred(world, localization):
    frame = int(np.median(localization.tracks.frame))
    boxes = world.detections
    own = boxes.box[(boxes.frame == frame) & (boxes.camera == 0)]
    regions = people_regions(0, frame, boxes, localization, world.scene, 0.05)
    np.testing.assert_array_equal(regions[: len(own)], own)
    assert len(regions) > len(own)
    lost = dataclasses.replace(world.scene.rig, registered=np.array([False, True, True, True]))
    scene = dataclasses.replace(world.scene, rig=lost)
    assert len(people_regions(0, frame, boxes, localization, scene, 0.05)) == len(own)


@pytest.mark.slow
def test_a_drawn_frame_shows_no_detail_of_people(world, localization):
    frame = int(np.median(localization.tracks.frame))
    boxes = world.detections
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (1080, 1920, 3)).astype(np.uint8)
    drawn = draw_frame(image, 0, frame, boxes, localization, world.scene, blur=True)
    for x1, y1, x2, y2 in boxes.box[(boxes.frame == frame) & (boxes.camera == 0)].astype(int):
        assert (
            drawn[y1 + 5 : y2 - 5, x1 + 5 : x2 - 5] == image[y1 + 5 : y2 - 5, x1 + 5 : x2 - 5]
        ).mean() < 0.1


@pytest.mark.slow
def test_people_out_of_the_picture_do_not_hide_it(world, localization):
    """Not even people beside a camera, whose projection is large but far outside."""
    size = np.asarray(world.scene.rig.image_size)
    for camera in range(4):
        for frame in np.unique(localization.tracks.frame):
            nobody = world.detections[:0]
            box = people_regions(camera, frame, nobody, localization, world.scene, 0.05)
            assert (box[:, 2:] - box[:, :2] < size[camera]).all()
            assert (box[:, 2:] > 0).all()
            assert (box[:, :2] < size[camera]).all()
