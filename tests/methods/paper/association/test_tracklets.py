"""Tracklets of one camera: by distance, by appearance, never over a gap."""

import numpy as np

from catfree import Detections
from catfree.methods.paper.association import link_tracklets, observe
from catfree.settings import TrackletSettings
from catfree.synthetic import make_layout

RIG = make_layout("ring4").rig


def link(rows, looks=None, **rules) -> list[int]:
    """Make tracklets of boxes 40 x 100 with rows (frame, camera, x, y), in the rows' order."""
    frame, camera, x, y = np.array(rows, float).T
    box = np.stack([x, y - 100, x + 40, y], axis=-1)
    embedding = None if looks is None else np.array(looks, float)
    seen = Detections(frame, camera, box, embedding=embedding)
    observations = observe(seen, RIG, keep=np.ones(len(rows), bool))
    tracklet = np.empty(len(rows), int)
    tracklet[observations.row] = link_tracklets(observations, TrackletSettings(**rules))
    return tracklet.tolist()


def test_a_person_who_moves_a_little_is_one_tracklet():
    assert link([(0, 0, 0, 500), (1, 0, 10, 500), (2, 0, 20, 505)]) == [0, 0, 0]


def test_cameras_do_not_mix():
    assert link([(0, 0, 0, 500), (1, 1, 0, 500)]) == [0, 1]


def test_a_missing_frame_ends_a_tracklet():
    rows = [(f, 0, 0, 500) for f in (0, 5, 15, 20)]
    assert link(rows) == [0, 0, 1, 1]


def test_nobody_jumps_more_than_three_quarters_of_a_body():
    assert link([(0, 0, 0, 500), (1, 0, 74, 500)]) == [0, 0]
    assert link([(0, 0, 0, 500), (1, 0, 76, 500)]) == [0, 1]
    assert link([(0, 0, 0, 500), (1, 0, 76, 500)], maximum_shift=2.0) == [0, 0]


def test_a_walker_who_leaves_his_own_box_is_one_tracklet():
    # Boxes are 40 wide: steps of 60 never overlap.
    assert link([(f, 0, 60 * f, 500) for f in range(5)]) == [0] * 5


def test_the_nearest_assignment_of_all_wins():
    rows = [(0, 0, 0, 500), (0, 0, 30, 500), (1, 0, 12, 500), (1, 0, 42, 500)]
    assert link(rows) == [0, 1, 0, 1]


def test_looks_carry_two_people_past_each_other():
    # They walk towards each other, 30 pixels per step, and pass between frames 2 and 3.
    rows = [(f, 0, 30 * f, 500) for f in range(6)] + [(f, 0, 150 - 30 * f, 510) for f in range(6)]
    right, left = [0] * 6, [1] * 6
    looks = [[1.0, 0.2]] * 6 + [[0.2, 1.0]] * 6
    assert link(rows, looks) == right + left


def test_people_who_look_different_are_not_linked():
    rows = [(0, 0, 0, 500), (1, 0, 0, 500)]
    assert link(rows, [[1, 0], [0, 1]]) == [0, 1]
    assert link(rows, [[1, 0], [1, 0.1]]) == [0, 0]
    assert link(rows, [[1, 0], [0, 1]], appearance_threshold=1.0) == [0, 0]


def test_two_detections_never_share_a_place_in_a_tracklet():
    rows = [(f, 0, x, 500) for f in range(4) for x in (0, 5, 10)]
    tracklet = np.array(link(rows)).reshape(4, 3)
    for line in tracklet:
        assert len(set(line.tolist())) == 3
