"""The detectors of all cameras: fitted once per run, and at work in this process or in several."""

import multiprocessing
import pickle
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from functools import cached_property
from itertools import islice
from types import TracebackType
from typing import Any, TypeVar

from catfree._run._cache import StageCache, code_hash
from catfree._run._worker import inherited, start_worker, worker_environment
from catfree.adapters.background._background_detector import (
    BackgroundDetector,
    FittedBackgroundDetector,
)
from catfree.adapters.background._foreground_memory import ForegroundMemory
from catfree.adapters.files._fingerprint import hash_parameters
from catfree.adapters.protocols import Detector, FittedToCamera, Image
from catfree.adapters.video._detect_videos import fit_to_cameras
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.errors import CatFreeError, FileFormatError
from catfree.types._annotations import Progress

T = TypeVar("T")
# A frame and one result per camera that has a picture.
Instant = tuple[int, dict[int, T]]
# From the detectors by camera, the frame and the pictures by camera to one result per camera. Each
# picture is worked on by itself.
InstantWork = Callable[[Mapping[int, Detector], int, Mapping[int, Image]], dict[int, T]]

CHUNK = 5  # instants per answer of a process
AHEAD = 2  # chunks that each process may be ahead, so that it never waits


class CameraDetectors:
    """Every camera's detector, fitted when first needed, with which pictures are worked on.

    With several workers, each is a spawned process that decodes and works on the pictures of its
    own cameras, until the end of the run: what a detector remembers of its camera stays with it.
    """

    def __init__(
        self,
        videos: SynchronizedVideos,
        detector: Detector | FittedToCamera,
        cache: StageCache | None = None,
        progress: Progress | None = None,
        *,
        workers: int = 1,
    ) -> None:
        """Start nothing yet.

        Args:
            videos: the footage to which detectors are fitted.
            detector: finds people in one picture.
            cache: holds backgrounds that an earlier run learned.
            progress: called as progress("fit", done, total).
            workers: most processes, at most one per camera. Detectors that are not fitted to
                cameras, and embedders that cannot be pickled, use this process only: those are
                networks, which use all processors.
        """
        self.detector = detector
        self._videos, self._cache, self._progress = videos, cache, progress
        several = isinstance(detector, FittedToCamera)
        self._workers = min(workers, videos.camera_count) if several else 1
        self._processes: list[ProcessPoolExecutor] = []

    def __enter__(self) -> "CameraDetectors":
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """End the processes."""
        for process in self._processes:
            process.shutdown(wait=False, cancel_futures=True)
        self._processes = []

    @cached_property
    def fitted(self) -> list[Detector]:
        """(C,) one detector per camera, as `fit_to_cameras` returns them.

        Each background is cached as soon as it is learned.

        Raises:
            InsufficientDataError: as `fit_to_cameras`.
            FileFormatError: as `fit_to_cameras`.
            WriteError: if a background cannot be stored.
        """
        videos, detector, cache, progress = (
            self._videos, self.detector, self._cache, self._progress,
        )  # fmt: skip
        if cache is None or not isinstance(detector, BackgroundDetector):
            return fit_to_cameras(videos, detector, progress)
        stage, common = "background", (code_hash("adapters", "types"), videos.fingerprint)

        def key(camera: int) -> str:
            return hash_parameters(stage, *common, detector.fingerprint, camera=camera)

        def keep(camera: int, fitted: Detector) -> None:
            if isinstance(fitted, FittedBackgroundDetector):
                cache.store(stage, key(camera), replace(fitted, memory=None))

        known: dict[int, Detector] = {}
        for camera in range(videos.camera_count):
            stored = cache.load(stage, key(camera), FittedBackgroundDetector)
            if stored is not None:
                memory = ForegroundMemory(stored.background.compare)
                known[camera] = replace(stored, memory=memory)
        return fit_to_cameras(videos, detector, progress, known=known, learnt=keep)

    def instants(
        self,
        videos: SynchronizedVideos,
        work: InstantWork[T],
        first: int = 0,
        *,
        detect: bool = True,
    ) -> Iterator[Instant[T]]:
        """Work on the pictures of all instants, in order.

        Args:
            videos: the footage, on any clock.
            work: on one instant; with several workers, on the pictures of one worker's cameras.
            first: position of the first instant, as `SynchronizedVideos.pictures_from`.
            detect: whether the work needs the detectors, which are fitted if need be.

        Yields:
            The frame, and the result of each camera that has a picture.

        Raises:
            FileFormatError: as `SynchronizedVideos.pictures_from`.
            CatFreeError: if the processes cannot be started; and what the work raises.
        """
        if self._workers > 1 and detect and _can_be_sent(work):
            yield from self._in_processes(videos, work, first)
            return
        detectors = dict(enumerate(self.fitted if detect else ()))
        for frame, pictures in videos.pictures_from(first):
            yield frame, work(detectors, frame, pictures)

    def _in_processes(
        self, videos: SynchronizedVideos, work: InstantWork[T], first: int
    ) -> Iterator[Instant[T]]:
        videos.interruption = None
        answers: list[deque[Future[_Answer]]] = []
        try:
            for begun in self._begin(videos, work, first):
                begun.result()
            answers = [
                deque(process.submit(_next_chunk) for _ in range(AHEAD))
                for process in self._processes
            ]
            while True:
                parts = [queue.popleft().result() for queue in answers]
                count = min(len(instants) for instants, _ in parts)
                for at in range(count):
                    results = [instants[at] for instants, _ in parts]
                    joined = {camera: one for _, some in results for camera, one in some.items()}
                    yield results[0][0], dict(sorted(joined.items()))
                if count < CHUNK:
                    ended = [error for instants, error in parts if len(instants) == count]
                    videos.interruption = next((error for error in ended if error), None)
                    return
                for process, queue in zip(self._processes, answers, strict=True):
                    queue.append(process.submit(_next_chunk))
        except BrokenProcessPool as error:
            raise CatFreeError(
                "The processes that look at the pictures ended early. Call run from under "
                "`if __name__ == '__main__':`, or with workers=1."
            ) from error
        finally:
            for future in (future for queue in answers for future in queue):
                future.cancel()

    def _begin(
        self, videos: SynchronizedVideos, work: InstantWork[Any], first: int
    ) -> list[Future[None]]:
        """Give each process its cameras' part of the work; start the processes if none run."""
        groups = [range(at, videos.camera_count, self._workers) for at in range(self._workers)]
        environment = worker_environment()
        if not self._processes:
            self._processes = [
                ProcessPoolExecutor(
                    1,
                    # Neither JAX nor OpenCV survive a fork.
                    mp_context=multiprocessing.get_context("spawn"),
                    initializer=_start_worker,
                    initargs=(environment, {camera: self.fitted[camera] for camera in cameras}),
                )
                for cameras in groups
            ]
        with inherited(environment):  # by processes, which start with their first task
            return [
                process.submit(_begin, videos, work, cameras, first)
                for process, cameras in zip(self._processes, groups, strict=True)
            ]


# An answer of a process: instants, fewer than asked for at the end, and what ended them.
_Answer = tuple[list[Instant[Any]], FileFormatError | None]

# Set only in worker processes: the detectors of its cameras, the footage and the work in progress.
_worker: dict[str, Any] = {}


def _start_worker(environment: Mapping[str, str], detectors: dict[int, Detector]) -> None:
    start_worker(environment)
    _worker["detectors"] = detectors


def _begin(videos: SynchronizedVideos, work: InstantWork[Any], cameras: range, first: int) -> None:
    detectors = _worker["detectors"]
    _worker["videos"] = videos
    _worker["instants"] = (
        (frame, work(detectors, frame, pictures))
        for frame, pictures in videos.pictures_from(first, cameras)
    )


def _next_chunk() -> _Answer:
    return list(islice(_worker["instants"], CHUNK)), _worker["videos"].interruption


def _can_be_sent(work: Callable[..., Any]) -> bool:
    try:
        pickle.dumps(work)
    except (pickle.PicklingError, AttributeError, TypeError):
        return False
    return True
