"""The refinement loop of `calibrate`: adjust the rig to confident people, and search again.

Refinement is local: a misplaced camera matches enough of a crowd to stay misplaced, and it distorts
the poses of the others. The people of the others reveal its true position.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from catfree.calibration._confident_people import confident_people
from catfree.calibration.people import (
    Calibration,
    doubtful_cameras,
    place_late_camera,
    reconsider,
    refine_with_correspondences,
    remove_offsets,
    without_camera,
)
from catfree.calibration.watching import estimate_clocks
from catfree.errors import CalibrationError, InsufficientDataError
from catfree.settings import Settings
from catfree.types import Detections
from catfree.types._annotations import Progress
from catfree.types._sampling import frame_step
from catfree.types._validation import shown_camera

FEWEST_TO_JUDGE = 3  # of three cameras, two that agree expose the third
RESTING = 0.2  # standard deviations; a smaller move adds two percent to a camera's error
ROUNDS = 6  # a rig absorbs part of a lag, which shows only after the rest is corrected
GAIN = 0.02  # relative difference of `_information` below which rigs count as equal


@dataclass(frozen=True)
class EvidenceLoop:
    """Alternate the evidence method and bundle adjustment on one sequence.

    Attributes:
        detections: (N,) boxes on the clocks as given.
        settings: settings of the evidence method and of the calibration.
        report: called as `report("refinement", done, rounds)`.
        camera_names: for error messages.
    """

    detections: Detections
    settings: Settings
    report: Progress
    camera_names: Sequence[str] | None = None

    def boxes(self, calibration: Calibration) -> Detections:
        """(N,) the boxes on the corrected clocks of a calibration."""
        return remove_offsets(self.detections, calibration.frame_offset)

    def settle(self, calibration: Calibration) -> Calibration:
        """Refine the rig, move every camera to where it fits best, and add missing cameras.

        Refined cameras expose a misplaced one, so the search is repeated until no camera changes,
        at most once per camera. A camera that fits nowhere is flagged; its boxes may be from
        another time.

        Raises:
            CalibrationError: if the cameras contradict each other and share too few people to
                determine which one is wrong.
        """
        best = self.refine(calibration)
        for _ in range(len(best.scene.rig.registered)):
            found = reconsider(best, self.boxes(best), self.settings.calibration)
            if found is None:
                break
            best = self.refine(found)
        return self.without_outliers(best)

    def with_late_cameras(self, calibration: Calibration, maximum: int) -> Calibration:
        """Place doubtful cameras of a settled rig at the clock offsets at which they fit.

        A camera with a wrong clock fits nowhere, or where it matches other people.

        Args:
            calibration: a settled rig.
            maximum: largest offset in frame numbers.

        Returns:
            The rig, with the offsets included in its `frame_offset`.
        """
        rules = self.settings.calibration
        doubtful = doubtful_cameras(calibration, self.boxes(calibration), rules)
        for done, camera in enumerate(doubtful):
            self.report("offsets", done, len(doubtful))
            boxes = self.boxes(calibration)
            found = place_late_camera(calibration, boxes, camera, maximum, rules)
            if found is None:
                continue
            try:
                found = self.settle(found)
            except CalibrationError:
                continue
            registered = found.scene.rig.registered
            if registered[camera] and registered[calibration.scene.rig.registered].all():
                calibration = found
        self.report("offsets", len(doubtful), len(doubtful))
        return calibration

    def synchronized(self, calibration: Calibration) -> Calibration:
        """Correct late cameras of a settled rig by whole frames while more boxes then fit better.

        Returns:
            The rig, with the corrections included in its `frame_offset`.
        """
        settings = replace(self.settings, method="evidence")
        step = frame_step(np.unique(self.detections.frame))
        kept = calibration
        least = (1 + GAIN) * _information(calibration)
        for _ in range(ROUNDS):
            if calibration.scene.rig.registered.sum() < FEWEST_TO_JUDGE:
                break
            try:
                boxes = self.boxes(calibration)
                clocks = estimate_clocks(calibration.scene, boxes, settings=settings)
            except InsufficientDataError:
                break
            offset = clocks.whole_offsets(step)
            if not offset.any():
                break
            corrected = replace(calibration, frame_offset=calibration.frame_offset + offset)
            calibration = self.refine(corrected)
            if _information(calibration) >= least:
                kept, least = calibration, _information(calibration)
        return kept

    def without_outliers(self, calibration: Calibration) -> Calibration:
        """Remove cameras whose boxes fit far worse than those of the others, and refine.

        Raises:
            CalibrationError: if the remaining cameras agree on too few people.
        """
        while (worst := self.outlier(calibration)) is not None:
            others = without_camera(calibration, worst)
            calibration = self.refine(others)
            # Two cameras never share confident people; if three or more do not, they relied on
            # `worst`.
            if calibration is others and others.scene.rig.registered.sum() >= FEWEST_TO_JUDGE:
                raise CalibrationError(
                    f"Camera {shown_camera(worst, self.camera_names)} contradicts the others, "
                    "which agree on too few people to tell which camera is wrong; record longer, "
                    "and check that the frames of all cameras show the same instants."
                )
        return calibration

    def outlier(self, calibration: Calibration) -> int | None:
        """Find the camera whose boxes fit worst, if they fit clearly worse than the others'."""
        residual, rules = calibration.camera_residual, self.settings.calibration
        if calibration.scene.rig.registered.sum() < FEWEST_TO_JUDGE or np.isnan(residual).all():
            return None
        worst = int(np.nanargmax(residual))
        usual = np.nanmedian(residual)
        return worst if residual[worst] > rules.strained_residual * usual else None

    def refine(self, calibration: Calibration) -> Calibration:
        """Refine in rounds until the cameras stop moving; discard a round that loses information.

        Information alone does not indicate convergence: as people become more certain, cameras move
        by most of their standard deviation while the information hardly rises. The information of
        the given rig is not comparable, because it refers to other boxes with other deviations.
        """
        rounds = self.settings.calibration.evidence_rounds
        best, least = calibration, 0.0
        for done in range(rounds):
            self.report("refinement", done, rounds)
            refined = self.refine_once(best)
            if refined is None or (1 + GAIN) * _information(refined) < least:
                break
            moved = largest_move(best, refined)
            best, least = refined, _information(refined)
            if moved < RESTING:
                break
        self.report("refinement", rounds, rounds)
        return best

    def refine_once(self, calibration: Calibration) -> Calibration | None:
        """Refine in one round; return None if there is too little evidence."""
        boxes = self.boxes(calibration)
        try:
            people = confident_people(boxes, calibration.scene, self.settings.evidence)
            return refine_with_correspondences(
                calibration,
                boxes,
                people.member,
                self.settings.calibration,
                box_sd=people.box_sd,
                repeats=people.repeats * people.stays,
            )
        except InsufficientDataError:
            return None


def _information(calibration: Calibration) -> float:
    """Return the support of a rig: the number of boxes that fit, over their mean squared residual.

    The residual alone would favor a rig in which a late camera lost most of its boxes.
    """
    return float(calibration.sightings.sum() / max(calibration.residual, 1e-9) ** 2)


def largest_move(before: Calibration, after: Calibration) -> float:
    """Largest move of a camera center between two rigs, in standard deviations of the second."""
    registered = after.scene.rig.registered
    distance = np.asarray(after.scene.rig.centers) - np.asarray(before.scene.rig.centers)
    variance = np.trace(after.center_covariance, axis1=1, axis2=2) / 3
    return float(
        (np.linalg.norm(distance, axis=1) / np.sqrt(np.maximum(variance, 1e-12)))[registered].max()
    )
