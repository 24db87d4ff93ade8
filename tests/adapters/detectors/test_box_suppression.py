import cv2
import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from catfree.adapters.detectors._box_suppression import box_overlap, suppress_boxes

coordinate = st.integers(0, 60)
boxes = (
    st.integers(0, 12)
    .flatmap(lambda n: arrays(np.float64, (n, 4), elements=coordinate.map(float)))
    .map(lambda b: np.concatenate([b[:, :2], b[:, :2] + 1 + b[:, 2:]], axis=1))
)


@given(boxes, st.floats(0.05, 1))
def test_survivors_do_not_overlap_and_the_rest_overlap_a_better_survivor(box, limit):
    score = np.linspace(1, 0.1, len(box))
    keep = suppress_boxes(box, score, limit, np.zeros(len(box), int), limit)
    overlap = box_overlap(box, box)
    np.fill_diagonal(overlap, 0)
    assert (overlap[np.ix_(keep, keep)] <= limit).all()
    for row in set(range(len(box))) - set(keep.tolist()):
        assert (overlap[row, keep[keep < row]] > limit).any()


@given(boxes.filter(len), st.sampled_from([0.31, 0.53, 0.71]))
def test_same_rows_as_opencv(box, limit):
    score = np.linspace(0.9, 0.1, len(box)).astype(np.float32)
    xywh = np.concatenate([box[:, :2], box[:, 2:] - box[:, :2]], axis=1)
    expected = cv2.dnn.NMSBoxes(xywh.tolist(), score.tolist(), 0.0, limit)
    keep = suppress_boxes(box, score, limit, np.zeros(len(box), int), limit)
    np.testing.assert_array_equal(keep, np.ravel(expected))


def test_boxes_of_other_windows_have_their_own_limit():
    box = np.array([[0, 0, 10, 10], [0, 0, 10, 6.0], [0, 0, 10, 6.1]])
    score = np.array([0.9, 0.8, 0.7])
    window = np.array([0, 0, 1])
    keep = suppress_boxes(box, score, 0.7, window, 0.5)
    np.testing.assert_array_equal(keep, [0, 1])


def test_no_boxes():
    assert suppress_boxes(np.zeros((0, 4)), np.zeros(0), 0.5, np.zeros(0, int), 0.5).shape == (0,)
