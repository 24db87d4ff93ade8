"""The loop of `calibrate`: sure people move the rig, and cameras that do not fit are placed anew.

Refinement alone only polishes: a camera that settled beside its place matches enough of a crowd to
stay there, and bends the others towards it. Only without it they show where it belongs.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from catfree.errors import InsufficientDataError
from catfree.rig.pedestrians import (
    Calibration,
    places_for,
    reconsider,
    refine_with_correspondences,
    without_camera,
)
from catfree.rig.strain import FEWEST_TO_COMPARE, most_strained
from catfree.rig.sure_people import sure_people
from catfree.settings import Settings
from catfree.types import Detections

# Of the residual: cameras in their places hardly differ in what the rest gains without them, one
# that keeps others out costs the rest a third.
BLOCKING = 0.9


@dataclass(frozen=True)
class EvidenceLoop:
    """The evidence method and the bundle adjustment in turns, on one sequence.

    Attributes:
        detections: (N,) boxes of synchronized cameras.
        settings: of the evidence method and of the calibration.
        report: called as `report("refinement", done, rounds)`.
    """

    detections: Detections
    settings: Settings
    report: Callable[[str, int, int], None]

    def settle(self, calibration: Calibration) -> Calibration:
        """The rig refined, with every camera where it fits best and missing ones added."""
        best = self._grow(self.relieve(self.refine(calibration)))
        freed = self.free(best)
        return best if freed is None else self._grow(self.relieve(freed))

    def _grow(self, best: Calibration) -> Calibration:
        """Search every camera's place anew until nothing is gained."""
        for _ in range(len(best.scene.rig.registered)):
            again = reconsider(best, self.detections, self.settings.calibration)
            if again is None:
                break
            grown = again.scene.rig.registered.sum() > best.scene.rig.registered.sum()
            best = self.relieve(self.refine(again))
            if not grown:
                break
        return best

    def refine(self, calibration: Calibration) -> Calibration:
        """The rig after as many turns as the settings ask for and there is evidence for."""
        rounds = self.settings.calibration.evidence_rounds
        for done in range(rounds):
            self.report("refinement", done, rounds)
            refined = self.turn(calibration)
            if refined is None:
                break
            calibration = refined
        self.report("refinement", rounds, rounds)
        return calibration

    def turn(self, calibration: Calibration) -> Calibration | None:
        """One turn; None where the evidence is too thin to refine with."""
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

    def relieve(self, calibration: Calibration) -> Calibration:
        """The rig with every strained camera where it fits, if there is such a place."""
        tried: set[int] = set()
        while (camera := most_strained(calibration.camera_residual, tried)) is not None:
            tried.add(camera)
            rest = without_camera(calibration, camera, self.settings.calibration)
            found = self._placed_best(self.refine(rest), camera)
            if found is not None and found.residual < calibration.residual:
                calibration = found
        return calibration

    def free(self, calibration: Calibration) -> Calibration | None:
        """The rig without the knot that keeps a camera out of it, if there is one.

        Where several cameras share an error, none of them stands out, and a camera that is right
        fits none of them. Each is taken out in turn; of one without which the rest fits far
        better, the place is searched anew.
        """
        registered = np.asarray(calibration.scene.rig.registered)
        missing = np.setdiff1d(self.detections.camera, np.flatnonzero(registered))
        if len(missing) == 0 or registered.sum() < FEWEST_TO_COMPARE:
            return None
        limit = BLOCKING * calibration.residual
        rests: list[tuple[Calibration, int]] = []
        for camera in np.flatnonzero(registered):
            rest = without_camera(calibration, int(camera), self.settings.calibration)
            turned = self.turn(rest)
            if turned is not None and turned.residual < limit:
                rests.append((turned, int(camera)))
        for rest, camera in sorted(rests, key=lambda item: item[0].residual):
            found = self._placed_best(self.refine(rest), camera)
            if found is not None and found.residual < limit:
                return found
        return None

    def _placed_best(self, rest: Calibration, camera: int) -> Calibration | None:
        """The rig with a missing camera in the place that leaves the smallest residual."""
        places = places_for(rest, self.detections, camera, self.settings.calibration)
        refined = [self.refine(place) for place in places]
        fitting = [found for found in refined if np.isfinite(found.camera_residual[camera])]
        return min(fitting, key=lambda found: found.residual, default=None)
