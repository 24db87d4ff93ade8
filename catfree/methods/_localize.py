"""`localize`: from person boxes and a scene to tracked ground positions."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Int

from catfree.errors import InsufficientDataError, InvalidInputError
from catfree.methods import evidence
from catfree.methods._expectation import with_expectation
from catfree.methods.paper._assemble import empty_localization
from catfree.methods.paper._localize_by_paper import localize_by_paper
from catfree.settings import Settings
from catfree.types import Detections, Localization, Scene
from catfree.types._annotations import Progress, as_progress
from catfree.types._detections import is_confident
from catfree.types._processes import require_own_process
from catfree.types._scene import require_plausible_heights, require_scene
from catfree.types._validation import (
    as_pictures,
    require_boxes_in_images,
    require_changing_pictures,
    require_different_cameras,
    require_few_people,
    require_instance,
    require_known_cameras,
    require_names,
    require_no_boxes,
)


def localize(
    detections: Detections,
    scene: Scene,
    settings: Settings | None = None,
    progress: Progress | None = None,
    *,
    silent: Any = None,
    camera_names: Sequence[str] | None = None,
) -> Localization:
    """Track people on the ground from their boxes in several calibrated views.

    Args:
        detections: person boxes of all cameras and frames, in any order. Boxes in float32 are
            measured in single precision.
        scene: cameras, ground and extent in any units and any frame of reference.
        settings: None for `Settings()`, the default method.
        progress: called as `progress(stage, done, total)`.
        silent: (K, 2) integers, frame and camera of each missing picture, because the camera failed
            or its video ended. A missing picture says nothing about people; in all other pictures
            of frames with any box, the absence of a box is evidence against people in view. The
            paper's method ignores it.
        camera_names: names for warnings and error messages, which otherwise give numbers.

    Returns:
        Tracks, every candidate with its fate, the thresholds and a label-free reliability summary,
        in the frame and units of the scene, on the clock of the detections. A similarity transform
        of the scene transforms the result and changes nothing else; the order of cameras,
        detections and frames has no effect.

    Raises:
        InvalidInputError: if a camera of a detection or of `silent` is not in the rig, a missing
            picture has a box, a picture has more than 1,000 boxes or an instant more than 5,000, or
            the number of names differs from that of cameras.
        InsufficientDataError: if fewer than two cameras are registered.
        ForkedProcessError: in a process forked after JAX was used.

    Source:
        Sec. "Method" of the paper for `Settings.paper()`; `catfree.methods.evidence` for the
        default.
    """
    require_own_process()
    settings = Settings() if settings is None else settings
    require_instance(detections, Detections, "detections")
    require_scene(scene)
    require_instance(settings, Settings, "settings")
    require_names(camera_names, scene.rig.camera_count)
    report = as_progress(progress)
    missing = _missing_pictures(silent, detections, scene, camera_names)
    keep = usable(detections, scene, settings, camera_names)
    result = None
    if keep.any() and settings.method == "paper":
        result = localize_by_paper(detections, scene, keep, settings, report)
    elif keep.any():
        with suppress(InsufficientDataError):  # no box of a person stands on the ground
            result = evidence.localize_by_evidence(
                detections,
                scene,
                settings.evidence,
                keep=keep,
                silent=missing,
                camera_names=camera_names,
                progress=report,
            )
    if result is None:
        result = empty_localization(
            scene.rig.camera_count,
            existence=settings.method == "evidence",
            detection_count=len(detections),
        )
    warnings = result.warnings
    frame, camera, box = detections.frame[keep], detections.camera[keep], detections.box[keep]
    warnings += _faults(
        lambda: require_plausible_heights(scene),
        lambda: require_boxes_in_images(camera, box, scene.rig.image_size, camera_names),
        lambda: require_different_cameras(frame, camera, box, camera_names),
        lambda: require_changing_pictures(frame, camera, box, camera_names),
    )
    if not keep.any():
        warnings += (_why_none_is_used(detections, scene, settings),)
    if keep.any() and not len(result.tracks):
        warnings += (_why_nobody_is_found(frame, camera),)
    tracks = replace(result.tracks, clock=detections.clock)
    return with_expectation(replace(result, tracks=tracks, warnings=warnings), settings)


def _why_none_is_used(detections: Detections, scene: Scene, settings: Settings) -> str:
    """Say that there are no boxes, or why all are left out, and what to do."""
    if not len(detections):
        return "There are no boxes, so nobody is found. Check the detector, or the file it wrote."
    none = f"None of the {len(detections)} boxes is used:"
    registered = scene.rig.registered[detections.camera]
    if not registered.any():
        return f"{none} their cameras are not registered. Check that boxes and scene fit together."
    score = detections.score
    if score is not None and score[registered].max() < settings.confidence:
        return (
            f"{none} the highest score is {score[registered].max():g}, below the confidence of "
            f"{settings.confidence:g}. Check the detector, or lower Settings.confidence."
        )
    return (
        f"{none} no confident one has confirmed ankles, which "
        "RaySettings.only_confirmed_ankles asks for. Set it to False."
    )


def _why_nobody_is_found(frame: Int[np.ndarray, " n"], camera: Int[np.ndarray, " n"]) -> str:
    """Say that no instant has boxes of two cameras, or what else to check."""
    pictures = np.unique(np.stack([frame, camera], -1), axis=0)
    if len(np.unique(frame)) == len(pictures):
        return (
            "Nobody is found: in no frame do two cameras have boxes. Check that the boxes of all "
            "cameras are given, and that they have the same frame numbers."
        )
    return (
        f"Nobody is found (boxes used: {len(frame)}). Check that boxes and scene have the same "
        "cameras in the same order, and the same image sizes."
    )


def _faults(*checks: Callable[[], object]) -> tuple[str, ...]:
    """List the sentences of failed checks, which are errors elsewhere but warnings here."""
    faults = []
    for check in checks:
        try:
            check()
        except InvalidInputError as error:
            faults.append(str(error))
    return tuple(faults)


def _missing_pictures(
    silent: Any, detections: Detections, scene: Scene, camera_names: Sequence[str] | None
) -> Int[np.ndarray, "k 2"]:
    """(K, 2) frame and camera of missing pictures.

    Raises:
        InvalidInputError: if a camera does not exist, or one of these pictures has a box.
    """
    rows = as_pictures(silent)
    require_known_cameras(rows[:, 1], scene.rig.camera_count)
    require_no_boxes(rows, detections.frame, detections.camera, camera_names)
    return rows


def usable(
    detections: Detections,
    scene: Scene,
    settings: Settings,
    camera_names: Sequence[str] | None = None,
) -> np.ndarray:
    """Mark the detections that are confident enough and of a registered camera, (N,).

    Raises:
        InvalidInputError: if a detection's camera is not in the rig, or a picture has more boxes
            than there can be people.
        InsufficientDataError: if fewer than two cameras are registered.
    """
    rig = scene.rig
    require_known_cameras(detections.camera, rig.camera_count)
    if rig.registered.sum() < 2:
        raise InsufficientDataError(
            f"Localization needs at least 2 registered cameras to intersect rays; this rig has "
            f"{int(rig.registered.sum())} of {rig.camera_count}. Add cameras or register them."
        )
    keep = rig.registered[detections.camera] & is_confident(detections, settings.confidence)
    if settings.rays.only_confirmed_ankles and detections.ankles_confirmed is not None:
        keep = keep & detections.ankles_confirmed
    require_few_people(detections.frame[keep], detections.camera[keep], camera_names)
    return keep
