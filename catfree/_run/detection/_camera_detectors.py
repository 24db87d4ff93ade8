"""The detectors of all cameras, fitted once per run and run in one or several processes."""

import contextlib
import multiprocessing
import os
import pickle
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from functools import cached_property, partial
from itertools import islice
from types import TracebackType
from typing import Any, NamedTuple, TypeVar

from catfree._run._cache import StageCache, content_key
from catfree._worker import (
    SPAWN,
    SpawnedProcesses,
    as_they_end,
    from_parent,
    inherited,
    worker_environment,
)
from catfree.adapters.background._background_detector import (
    BackgroundDetector,
    FittedBackgroundDetector,
)
from catfree.adapters.background._foreground_memory import ForegroundMemory
from catfree.adapters.protocols import Detector, FittedToCamera, Image
from catfree.adapters.video._detect_videos import fit_to_camera, fit_to_cameras
from catfree.adapters.video._synchronized_videos import SynchronizedVideos
from catfree.errors import CatFreeError
from catfree.types._annotations import Progress, as_progress

T = TypeVar("T")
# A frame and one result per camera that has a picture.
Instant = tuple[int, dict[int, T]]
# From the detectors by camera, the frame and the pictures by camera to one result per camera. Each
# picture is processed independently.
InstantWork = Callable[[Mapping[int, Detector], int, Mapping[int, Image]], dict[int, T]]

DETECTION_CODE = ("adapters", "types")  # packages whose code determines the detections
CHUNK = 5  # instants per answer of a process
AHEAD = 2  # chunks that each process may be ahead, so that it never waits


class CameraDetectors:
    """The detectors of all cameras, fitted when first needed, and the work on their pictures.

    With several workers, each is a spawned process that decodes and processes the pictures of its
    own cameras until the end of the run, so a detector's memory of its camera stays in one process.
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
        """Store the arguments; no process starts yet.

        Args:
            videos: the footage to which detectors are fitted.
            detector: finds people in one picture.
            cache: holds backgrounds and detections of an earlier run.
            progress: called as progress(stage, done, total), with "fit" or the stage of `instants`.
            workers: maximum number of processes, at most one per camera. This process does all the
                work if it may not start others, if the detector or embedder cannot be pickled, or
                if the detector is not fitted to cameras: it is then a network, which uses all
                processors.
        """
        self.detector, self.progress = detector, as_progress(progress)
        self.videos, self.cache = videos, cache
        several = (
            workers > 1
            and isinstance(detector, FittedToCamera)
            and not multiprocessing.current_process().daemon
            and _can_be_sent(detector)
        )
        self._workers = min(workers, videos.camera_count) if several else 1
        self._processes: list[SpawnedProcesses] = []
        self._started: set[int] = set()
        self._reports: Any = None

    def __enter__(self) -> "CameraDetectors":
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """End the processes; after an error immediately, even during work."""
        if kind is not None:
            for child in multiprocessing.active_children():
                if child.pid in self._started:
                    child.terminate()
        for process in self._processes:
            # A process that is still importing would report that its parent is gone.
            process.shutdown(wait=kind is not None, cancel_futures=True)
        self._processes, self._started = [], set()

    @cached_property
    def fitted(self) -> list[Detector]:
        """(C,) one detector per camera, as `fit_to_cameras` returns them.

        Each background is cached as soon as it is learned.

        Raises:
            InsufficientDataError: as `fit_to_cameras`.
            FileFormatError: as `fit_to_cameras`.
            WriteError: if a background cannot be stored.
        """
        videos, detector, cache = self.videos, self.detector, self.cache
        known: dict[int, Detector] = {}
        if cache is None or not isinstance(detector, BackgroundDetector):
            return self._fit(known, lambda camera, fitted: None)
        stage, footage = "background", videos.fingerprint

        def key(camera: int) -> str:
            return content_key(
                stage, *DETECTION_CODE, videos=footage, detector=detector, camera=camera
            )

        def keep(camera: int, fitted: Detector) -> None:
            if isinstance(fitted, FittedBackgroundDetector):
                cache.store(stage, key(camera), replace(fitted, memory=None))

        for camera in range(videos.camera_count):
            stored = cache.load(stage, key(camera), FittedBackgroundDetector)
            if stored is not None:
                known[camera] = _remembering(stored)
        return self._fit(known, keep)

    def _fit(
        self, known: Mapping[int, Detector], learned: Callable[[int, Detector], None]
    ) -> list[Detector]:
        """Fit the cameras that are not fitted yet."""
        videos, detector, progress = self.videos, self.detector, self.progress
        if self._workers == 1 or not isinstance(detector, FittedToCamera):
            return fit_to_cameras(videos, detector, progress, known=known, learned=learned)
        total = sum(one.pictures for at, one in enumerate(videos.footage) if at not in known)
        fitted = dict(known)
        with self._running() as processes:
            tasks: dict[Future[Detector], int] = {
                processes[camera % self._workers].submit(
                    _fit_here, videos, detector, camera, known.get(camera)
                ): camera
                for camera in range(videos.camera_count)
            }
            for task in as_they_end(
                tasks, self._reports, lambda done: progress("fit", done, total)
            ):
                camera = tasks[task]
                if camera not in known:
                    fitted[camera] = _remembering(task.result())
                    learned(camera, fitted[camera])
        return [fitted[camera] for camera in range(videos.camera_count)]

    def instants(
        self,
        videos: SynchronizedVideos,
        work: InstantWork[T],
        first: int = 0,
        *,
        stage: str,
        detect: bool = True,
    ) -> Iterator[Instant[T]]:
        """Process the pictures of all instants, in order.

        Args:
            videos: the footage, on any clock.
            work: processes one instant; with several workers, the pictures of one worker's cameras.
            first: position of the first instant, as `SynchronizedVideos.pictures_from`.
            stage: the name by which each finished instant is reported.
            detect: whether the work needs the detectors, which are then fitted if necessary.

        Yields:
            The frame, and the result of each camera that has a picture.

        Raises:
            FileFormatError: as `SynchronizedVideos.pictures_from`.
            CatFreeError: if the processes cannot be started, or whatever `work` raises.
        """
        if self._workers > 1 and detect and _can_be_sent(work):
            instants = self._in_processes(videos, work, first)
        else:
            detectors = dict(enumerate(self.fitted if detect else ()))
            instants = (
                (frame, work(detectors, frame, pictures))
                for frame, pictures in videos.pictures_from(first)
            )
        for done, instant in enumerate(instants, start=first + 1):
            yield instant
            self.progress(stage, done, videos.frame_count)

    def _in_processes(
        self, videos: SynchronizedVideos, work: InstantWork[T], first: int
    ) -> Iterator[Instant[T]]:
        videos.interruption = None
        _ = self.fitted  # fit them in the processes
        with self._running() as processes, contextlib.ExitStack() as stack:
            begun = [
                process.submit(
                    _begin, videos, work, range(at, videos.camera_count, len(processes)), first
                )
                for at, process in enumerate(processes)
            ]
            for one in begun:
                one.result()
            # All processes begin before the first answer is awaited.
            ahead = [
                deque(process.submit(_next_chunk) for _ in range(AHEAD)) for process in processes
            ]
            streams = [
                stack.enter_context(contextlib.closing(_answers(*one)))
                for one in zip(processes, ahead, strict=True)
            ]
            for done, parts in enumerate(zip(*streams, strict=True), start=first):
                ends = [part for part in parts if isinstance(part, _End)]
                if ends:
                    # As in one process, where pictures are decoded before they are processed.
                    end = max(ends, key=lambda end: end.is_of_footage)
                    if not end.is_of_footage:
                        raise end.error
                    videos.interruption, videos.whole = end.error, done
                    return
                results = (result for _, some in parts for result in some.items())
                yield parts[0][0], dict(sorted(results))

    @contextlib.contextmanager
    def _running(self) -> Iterator[list[SpawnedProcesses]]:
        """Yield the processes, started if needed; camera c uses process c modulo their number."""
        try:
            if not self._processes:
                self._start()
            yield self._processes
        except BrokenProcessPool as error:
            raise CatFreeError(
                "The detection processes ended early. Call run from under `if __name__ == "
                "'__main__':`, or with workers=1."
            ) from error

    def _start(self) -> None:
        environment = worker_environment()
        try:
            self._reports = SPAWN.SimpleQueue()
            self._processes = [
                SpawnedProcesses(1, environment, self._reports) for _ in range(self._workers)
            ]
            with inherited(environment):  # a process starts with its first task
                begun = [process.submit(os.getpid) for process in self._processes]
                self._started = {task.result() for task in begun}
        except OSError as error:
            raise CatFreeError(
                f"The detection processes cannot be started ({error}). Call run with workers=1."
            ) from error


def _remembering(detector: Detector) -> Detector:
    """Return the detector with its own memory, if it can have one."""
    if not isinstance(detector, FittedBackgroundDetector):
        return detector
    return replace(detector, memory=ForegroundMemory(detector.background.compare))


class _End(NamedTuple):
    """Sent by a process instead of an instant that it could not process.

    Attributes:
        error: raised by the work or the footage.
        is_of_footage: whether the footage was interrupted.
    """

    error: Any
    is_of_footage: bool


def _answers(
    process: SpawnedProcesses, chunks: deque[Future[list[Any]]]
) -> Generator[Any, None, None]:
    """Yield the instants of a process, each an `Instant` or the `_End`, and ask for more."""
    try:
        while chunk := chunks.popleft().result():
            yield from chunk
            chunks.append(process.submit(_next_chunk))
    finally:
        for future in chunks:
            future.cancel()


# Set only in worker processes: the detectors of their cameras and the instants to process.
_worker: dict[str, Any] = {"detectors": {}}


def _fit_here(
    videos: SynchronizedVideos, detector: FittedToCamera, camera: int, known: Detector | None
) -> Detector:
    """Fit a camera unless its detector is known; keep it, and return it without its memory."""
    try:
        fitted = known
        if fitted is None:
            report = partial(from_parent["reports"].put, 1)
            fitted = fit_to_camera(videos, detector, camera, report)
    except Exception as error:
        raise _sendable(error) from None
    _worker["detectors"][camera] = fitted
    if isinstance(fitted, FittedBackgroundDetector):
        return replace(fitted, memory=None)
    if not _can_be_sent(fitted):
        raise CatFreeError(
            f"The detector fitted to camera {camera} is of type {type(fitted).__name__}, which "
            "cannot be pickled and so cannot leave its process. Call run with workers=1."
        )
    return fitted


def _begin(videos: SynchronizedVideos, work: InstantWork[Any], cameras: range, first: int) -> None:
    def instants() -> Iterator[Any]:
        try:
            for frame, pictures in videos.pictures_from(first, cameras):
                yield frame, work(_worker["detectors"], frame, pictures)
        except Exception as error:
            yield _End(_sendable(error), False)
        if videos.interruption is not None:
            yield _End(videos.interruption, True)

    _worker["instants"] = instants()


def _next_chunk() -> list[Any]:
    return list(islice(_worker["instants"], CHUNK))


def _can_be_sent(value: Any) -> bool:
    try:
        pickle.dumps(value)
    except Exception:  # user code may raise any class
        return False
    return True


def _sendable(error: Exception) -> Exception:
    """Return the error, or its text if its class cannot be unpickled."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return CatFreeError(f"{type(error).__name__}: {error}")
    return error
