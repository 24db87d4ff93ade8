"""Run `cf.localize` with the paper's method, caching the first stages between variants.

Association takes most of the time and does not depend on filters or trajectories, which most tables
vary. The result equals that of `cf.localize`; `tests/benchmarks` compares them.
"""

import dataclasses
from functools import cache

import catfree as cf
from benchmarks.paper.sequences import Sequence
from catfree.methods._localize import usable
from catfree.methods.paper._localize_by_paper import (
    Associated,
    associate_detections,
    locate_people,
)
from catfree.settings import SelectionSettings, TrajectorySettings


def localize_staged(sequence: Sequence, scene: cf.Scene, settings: cf.Settings) -> cf.Localization:
    """Localize by the paper's method; use `cf.localize` for any other.

    Args:
        sequence: sequence to localize.
        scene: the recovered or the true scene of the sequence.
        settings: settings of the run.
    """
    if settings.method != "paper":
        return cf.localize(sequence.detections, scene, settings)
    # Filters and trajectories come later, so all their variants share one association.
    first = dataclasses.replace(
        settings, selection=SelectionSettings(), trajectories=TrajectorySettings()
    )
    associated = _associate(sequence, scene is sequence.true_scene, first)
    if associated is None:
        return cf.localize(sequence.detections, scene, settings)
    return locate_people(associated, scene, settings)


@cache
def _associate(sequence: Sequence, true_rig: bool, settings: cf.Settings) -> Associated | None:
    """Run the stages of the paper up to the cross-view groups; return None without boxes."""
    scene = sequence.true_scene if true_rig else sequence.scene
    assert scene is not None
    keep = usable(sequence.detections, scene, settings)
    if not keep.any():
        return None
    return associate_detections(sequence.detections, scene, keep, settings)
