"""The evidence method as a list of passes, each from one `EvidenceState` to the next."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Int

from catfree.methods.evidence._state import EvidenceState
from catfree.methods.evidence.learn._self_calibration import self_calibrate
from catfree.methods.evidence.observe._boxes import float_width_of
from catfree.methods.evidence.passes._add_pose_errors import add_pose_errors
from catfree.methods.evidence.passes._choose_reported import choose_reported
from catfree.methods.evidence.passes._follow_people import follow_people
from catfree.methods.evidence.passes._group_boxes import group_boxes
from catfree.methods.evidence.passes._learn_looks import learn_looks
from catfree.methods.evidence.passes._name_people import name_people
from catfree.methods.evidence.passes._observe_boxes import observe_boxes
from catfree.methods.evidence.passes._weigh_groups import weigh_groups
from catfree.settings import EvidenceSettings
from catfree.types import Detections, Scene
from catfree.types._annotations import Progress, as_progress

Pass = Callable[[EvidenceState, EvidenceSettings], EvidenceState]

ASSOCIATE: tuple[Pass, ...] = (group_boxes, weigh_groups, follow_people)
FINISH: tuple[Pass, ...] = (name_people, add_pose_errors)


def solve(
    detections: Detections,
    scene: Scene,
    settings: EvidenceSettings | None = None,
    *,
    keep: Bool[np.ndarray, " n"] | None = None,
    silent: Int[np.ndarray, "k 2"] | None = None,
    progress: Progress | None = None,
    finish: bool = True,
) -> EvidenceState:
    """Find the people of a sequence from boxes and missing boxes.

    Args:
        detections: boxes of all cameras and frames, in any order; their float width is used by
            compiled functions.
        scene: rig and ground in any units; cameras that are not registered are ignored.
        settings: constants and switches.
        keep: (N,) detections to use; None for all.
        silent: (K, 2) frame and camera of missing pictures.
        progress: called as `progress(stage, done, total)`.
        finish: whether to repair identities over the whole sequence and to add pose errors to the
            covariances. A bundle adjustment needs neither.

    Returns:
        Tracks and all intermediate results; they do not depend on JAX's configuration.

    Raises:
        InsufficientDataError: if no box of a registered camera stands on the ground.
    """
    settings = settings or EvidenceSettings()
    report = as_progress(progress)
    with float_width_of(detections.box):
        report("self-calibration", 0, 1)
        # Keep no other reference to the used detections: they may be a copy of all embeddings.
        learned = self_calibrate(detections if keep is None else detections[keep], scene, settings)
        state = observe_boxes(detections, scene, *learned, settings, silent, keep)
        # The tracks of each round are the priors of the next.
        rounds = settings.passes if state.is_tracked(settings) else 1
        passes = (learn_looks, *(ASSOCIATE * rounds), choose_reported, *(FINISH * finish))
        for index, run in enumerate(passes):
            report("association", index, len(passes))
            state = run(state, settings)
        report("association", len(passes), len(passes))
    return state
