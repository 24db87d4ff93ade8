"""Detectors for worker processes, which import this module and not the tests' own imports."""

import os
import threading
import time
from dataclasses import dataclass, field

import numpy as np

from catfree.adapters import FrameDetections
from catfree.errors import InsufficientDataError


@dataclass
class Fitted:
    """Find a box or, in one camera, return something else from one picture on."""

    fingerprint: str
    wrong_from: int
    calls: int = 0

    def __call__(self, image):
        self.calls += 1
        if self.calls > self.wrong_from:
            return "nobody"
        return FrameDetections(np.array([[1.0, 1, 9, 20]]), np.ones(1))


@dataclass
class Fits:
    """A detector fitted to each camera."""

    fingerprint: str
    wrong_from: int
    kind: type = Fitted

    def fit(self, images):
        return self.kind(self.fingerprint, self.wrong_from)


@dataclass
class EndsItsProcess(Fitted):
    """End the process, as the system does when memory is short."""

    def __call__(self, image):
        os._exit(1)


@dataclass
class FailsAlone(Fits):
    """Fail on the pictures of the first camera, and take minutes for those of the others."""

    def fit(self, images):
        if next(iter(images))[0, 0, 0] == 0:
            raise InsufficientDataError("nothing to learn")
        time.sleep(300)
        return super().fit(images)


class TwoWordsError(Exception):
    """A third-party exception that cannot be unpickled."""

    def __init__(self, one, two):
        super().__init__(f"{one} {two}")


@dataclass
class FittedFails(Fitted):
    """A detector whose library fails."""

    def __call__(self, image):
        raise TwoWordsError("network", "down")


@dataclass
class WrongInBright(Fitted):
    """Fail only on bright pictures."""

    def __call__(self, image):
        found = super().__call__(image)
        return found if image[0, 0, 0] else FrameDetections(np.zeros((0, 4)), np.zeros(0))


@dataclass
class Locked(Fits):
    """Cannot be pickled."""

    lock: object = field(default_factory=threading.Lock)


@dataclass
class FittedLocked(Fitted):
    """Cannot be pickled."""

    lock: object = field(default_factory=threading.Lock)


class LooksOfTwoLengths:
    """Return longer embeddings for brighter pictures."""

    fingerprint = "looks"

    def __call__(self, image, box):
        return np.ones((len(box), 3 + int(image[0, 0, 0] > 50)))
