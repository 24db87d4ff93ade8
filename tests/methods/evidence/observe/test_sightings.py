"""Predicted boxes and their derivatives against the projection and finite differences."""

import numpy as np
import pytest

from catfree.geometry._person import box_edges
from catfree.methods.evidence.observe._sightings import sightings_by_camera
from catfree.methods.evidence.observe._views import ground_views
from catfree.settings._calibration_settings import FOOT_AHEAD
from tests.methods.evidence.evidence_worlds import HEIGHT, make_rig, make_scene, measured

STEP = 1e-5


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("people", [0, 1, 300])
def test_edges_are_projected_and_slopes_are_differences(people):
    views = ground_views(make_scene(make_rig()), HEIGHT)
    rng = np.random.default_rng(people)
    state = np.column_stack([rng.uniform(-1, 1, (people, 2)), rng.normal(1, 0.05, people)])
    box = np.arange(5 * people).reshape(people, 5)
    member, view = np.where(rng.random(box.shape) < 0.7, box, -1), np.tile(np.arange(5), people)
    found = list(sightings_by_camera(state, member, measured(5 * people, 2), view, views))
    assert len(found) == 5
    for camera, seen in enumerate(found):
        np.testing.assert_array_equal(seen.person, np.flatnonzero(member[:, camera] >= 0))
        np.testing.assert_array_equal(seen.box, 5 * seen.person + camera)
        assert seen.slopes.shape == (len(seen.box), 3, 4)
        assert (seen.precision == 0.5).all()

        def edges(move, above=0.0, people=state[seen.person], camera=camera):
            matrix = views.matrix[camera].copy()
            matrix[:, 3] += above * matrix[:, 2]
            return box_edges(matrix, people + move, views.station[camera], FOOT_AHEAD)

        np.testing.assert_allclose(seen.edges, edges(0), rtol=1e-9)
        moves = [*((move, 0) for move in np.eye(3)), (np.zeros(3), 1)]
        for k, (move, above) in enumerate(moves):
            ahead, behind = (edges(s * move, s * above) for s in (STEP, -STEP))
            slope = (ahead - behind) / (2 * STEP)
            np.testing.assert_allclose(seen.slopes[..., k], slope, rtol=1e-5, atol=1e-4)


@pytest.mark.usefixtures("x64")
def test_unused_edges_count_for_nothing():
    views = ground_views(make_scene(make_rig()), HEIGHT)
    boxes = measured(5, 2)
    boxes.used[:, 2] = False
    one = np.array([[0.0, 0.0, 1.0]]), np.arange(5)[None]
    for seen in sightings_by_camera(*one, boxes, np.arange(5), views):
        np.testing.assert_array_equal(seen.precision, [[0.5, 0.5, 0]])
