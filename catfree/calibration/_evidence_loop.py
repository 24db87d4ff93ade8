"""The loop of `calibrate`: sure people move the rig, and cameras that do not fit are placed anew.

Refinement alone only polishes: a camera that settled beside its place matches enough of a crowd to
stay there, and bends the others towards it. Only without it they show where it belongs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from catfree.calibration._confident_people import sure_people
from catfree.calibration._refinement import SAME_RESIDUAL
from catfree.calibration.people import (
    Calibration,
    places_for,
    reconsider,
    refine_with_correspondences,
    without_camera,
)
from catfree.calibration.people._residual_outliers import most_strained, strained_cameras
from catfree.errors import CalibrationError, InsufficientDataError
from catfree.settings import Settings
from catfree.types import Detections
from catfree.types._progress import Progress

FEWEST_TO_FLAG = 3  # of three cameras, two that agree tell that the third does not
RESTING = 0.2  # standard deviations; a move by less adds two per cent to the error of a camera


@dataclass(frozen=True)
class EvidenceLoop:
    """The evidence method and the bundle adjustment in turns, on one sequence.

    Attributes:
        detections: (N,) boxes of synchronized cameras.
        settings: of the evidence method and of the calibration.
        report: called as `report("refinement", done, rounds)`.
        names: of all cameras, for messages.
    """

    detections: Detections
    settings: Settings
    report: Progress
    names: Sequence[str] | None = None

    def settle(self, calibration: Calibration) -> Calibration:
        """The rig refined, with every camera where it fits best and missing ones added.

        A camera that fits nowhere as the others do is flagged: its boxes may be of another time.

        Raises:
            CalibrationError: if the cameras contradict each other and too few people tell why.
        """
        best = self._grow(self.replace_strained(self.refine(calibration)))
        freed = self.replace_blocking(best)
        if freed is not None:
            best = self._grow(self.replace_strained(freed))
        return self.without_strained(best)

    def without_strained(self, calibration: Calibration) -> Calibration:
        """The rig without cameras whose boxes fit far worse than the others' do, refined.

        Raises:
            CalibrationError: if those that remain do not agree on enough people to stand alone.
        """
        rules = self.settings.calibration
        while (
            calibration.scene.rig.registered.sum() >= FEWEST_TO_FLAG
            and strained_cameras(calibration.camera_residual, rules).any()
        ):
            worst = int(np.nanargmax(calibration.camera_residual))
            rest = without_camera(calibration, worst, rules)
            calibration = self.refine(rest)
            # Two cameras never share sure people; more that do not were held by the one that left.
            if calibration is rest and rest.scene.rig.registered.sum() >= FEWEST_TO_FLAG:
                raise CalibrationError(
                    f"Camera {self.names[worst] if self.names else worst} contradicts the others, "
                    "and they agree on too few people to tell who is right. Record longer, and "
                    "check that the frames of all cameras show the same instants."
                )
        return calibration

    def _grow(self, best: Calibration) -> Calibration:
        """Search every camera's place anew until nothing is gained."""
        for _ in range(len(best.scene.rig.registered)):
            again = reconsider(best, self.detections, self.settings.calibration)
            if again is None:
                break
            grown = again.scene.rig.registered.sum() > best.scene.rig.registered.sum()
            best = self.replace_strained(self.refine(again))
            if not grown:
                break
        return best

    def refine(self, calibration: Calibration) -> Calibration:
        """The rig after rounds that go on until it rests, without one in which the residual rises.

        The residual alone is no sign of rest: with people who are surer cameras still move by most
        of their standard deviation while it hardly falls. That of the given rig is no measure at
        all, since other boxes had other deviations there.
        """
        rounds = self.settings.calibration.evidence_rounds
        best, residual = calibration, np.inf
        for done in range(rounds):
            self.report("refinement", done, rounds)
            refined = self.refine_once(best)
            if refined is None or refined.residual > (1 + SAME_RESIDUAL) * residual:
                break
            moved = largest_move(best, refined)
            best, residual = refined, refined.residual
            if moved < RESTING:
                break
        self.report("refinement", rounds, rounds)
        return best

    def refine_once(self, calibration: Calibration) -> Calibration | None:
        """One round; None where the evidence is too thin to refine with."""
        try:
            people = sure_people(self.detections, calibration.scene, self.settings.evidence)
            return refine_with_correspondences(
                calibration,
                self.detections,
                people.member,
                self.settings.calibration,
                box_sd=people.box_sd,
            )
        except InsufficientDataError:
            return None

    def replace_strained(self, calibration: Calibration) -> Calibration:
        """The rig with every strained camera where more of its boxes fit, if there is a place."""
        tried: set[int] = set()
        while (camera := self._most_strained(calibration, tried)) is not None:
            tried.add(camera)
            rest = without_camera(calibration, camera, self.settings.calibration)
            calibration = self._better_placed(self.refine(rest), camera, calibration) or calibration
        return calibration

    def replace_blocking(self, calibration: Calibration) -> Calibration | None:
        """The rig with a camera moved that keeps another one out of it, if there is such a one.

        Where several cameras share an error, none of them stands out, and a camera that is right
        fits none of them. Each is taken out in turn; of one without which the rest fits far
        better, the place is searched anew.
        """
        rules = self.settings.calibration
        registered = np.asarray(calibration.scene.rig.registered)
        missing = ~registered & (self._boxes(len(registered)) > rules.minimum_matches)
        if not missing.any() or registered.sum() < rules.fewest_to_compare:
            return None
        rests: list[tuple[Calibration, int]] = []
        for camera in np.flatnonzero(registered):
            rest = self.refine_once(without_camera(calibration, int(camera), rules))
            if rest is not None and rest.residual < rules.blocking_share * calibration.residual:
                rests.append((rest, int(camera)))
        for rest, camera in sorted(rests, key=lambda item: item[0].residual):
            found = self._better_placed(self.refine(rest), camera, calibration)
            if found is not None:
                return found
        return None

    def _better_placed(
        self, rest: Calibration, camera: int, present: Calibration
    ) -> Calibration | None:
        """The rig with a missing camera where more boxes belong to sure people than at present.

        Residuals would prefer a camera that lost all of its people.
        """
        places = places_for(rest, self.detections, camera, self.settings.calibration)
        refined = [self.refine(place) for place in places]
        more = [
            found
            for found in refined
            if found.sightings[camera] > 0 and found.sightings.sum() > present.sightings.sum()
        ]
        return max(more, key=lambda found: (found.sightings.sum(), -found.residual), default=None)

    def _most_strained(self, calibration: Calibration, tried: set[int]) -> int | None:
        registered = np.asarray(calibration.scene.rig.registered)
        boxes = np.maximum(self._boxes(len(registered)), 1)
        support = np.where(registered, calibration.sightings / boxes, np.nan)
        return most_strained(calibration.camera_residual, support, self.settings.calibration, tried)

    def _boxes(self, cameras: int) -> np.ndarray:
        return np.bincount(self.detections.camera, minlength=cameras)[:cameras]


def largest_move(before: Calibration, after: Calibration) -> float:
    """Largest way of a camera centre between two rigs, in its standard deviations in the second."""
    known = np.asarray(after.scene.rig.registered)
    way = np.asarray(after.scene.rig.centers) - np.asarray(before.scene.rig.centers)
    variance = np.trace(after.center_covariance, axis1=1, axis2=2) / 3
    return float((np.linalg.norm(way, axis=1) / np.sqrt(np.maximum(variance, 1e-12)))[known].max())
