"""Person detections: boxes with optional scores, ankles, appearance and keypoints."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.errors import InvalidInputError, needing, quoted, shortened
from catfree.types._archive import load_record, naming_file, save_arrays
from catfree.types._clock import Clock, clock_from_array, clock_to_array, require_clock
from catfree.types._sampling import select_rows
from catfree.types._validation import (
    as_boolean,
    as_count,
    as_float,
    as_instances,
    as_integer,
    as_rows,
    refuse,
    require_boxes,
    require_finite,
    require_shape,
)

if TYPE_CHECKING:
    import pandas

MOST_CAMERAS = 10_000  # larger indices are serial numbers; memory grows with the largest
WIDEST_SPAN = 2**53  # frames; larger differences are not exact as floats (104 days in nanoseconds)


class Detections(eqx.Module):
    """Person detections of all cameras and frames, one row each, in any order.

    Attributes:
        frame: (N,) int64, the synchronized frame (time index) of each box; any integers
            less than 2^53 apart.
        camera: (N,) int64, index into the rig's cameras, from 0 to at most 9,999.
        box: (N, 4) x1, y1, x2, y2 in original image pixels, the center of the top-left pixel at
            (0, 0); float dtype is kept, other numbers become float64.
        score: (N,) detector confidence in [0, 1], or None.
        ankles_confirmed: (N,) whether both ankle keypoints were detected, or None if no pose
            estimator ran.
        embedding: (N, D) appearance vector, L2-normalized by its embedder, or None.
        keypoints: (N, 17, 3) COCO keypoints as x, y in pixels and confidence, or None.
        clock: maps frame numbers to times, or None if unknown.
    """

    frame: Int[np.ndarray, " n"]
    camera: Int[np.ndarray, " n"]
    box: Float[np.ndarray, "n 4"]
    score: Float[np.ndarray, " n"] | None
    ankles_confirmed: Bool[np.ndarray, " n"] | None
    embedding: Float[np.ndarray, "n d"] | None
    keypoints: Float[np.ndarray, "n 17 3"] | None
    clock: Clock | None = eqx.field(static=True)

    def __init__(
        self,
        frame: Any,
        camera: Any,
        box: Any,
        score: Any = None,
        ankles_confirmed: Any = None,
        embedding: Any = None,
        keypoints: Any = None,
        clock: Any = None,
    ) -> None:
        """Validate and store.

        Raises:
            InvalidInputError: naming the first wrong shape, value that is not finite, box without
                area, camera below 0 or above 9,999, or score outside [0, 1]; or if the frames span
                2^53 or more.
        """
        self.frame = as_integer(frame, "frame")
        self.camera = as_integer(camera, "camera")
        self.box = as_rows(box, 4, "box")
        self.score = None if score is None else np.asarray(as_float(score, "score"))
        self.ankles_confirmed = (
            None if ankles_confirmed is None else as_boolean(ankles_confirmed, "ankles_confirmed")
        )
        self.embedding = None if embedding is None else np.asarray(as_float(embedding, "embedding"))
        if self.embedding is not None and self.embedding.shape == (0,):
            self.embedding = self.embedding.reshape(0, 0)
        self.keypoints = None if keypoints is None else np.asarray(as_float(keypoints, "keypoints"))
        if self.keypoints is not None and self.keypoints.shape == (0,):
            self.keypoints = self.keypoints.reshape(0, 17, 3)
        self.clock = require_clock(clock)
        self._check()

    def _check(self) -> None:
        require_shape(self.frame, (None,), "frame")
        n = len(self.frame)
        if n and int(self.frame.max()) - int(self.frame.min()) >= WIDEST_SPAN:
            raise InvalidInputError(
                f"frame goes from {self.frame.min()} to {self.frame.max()}: differences beyond "
                "2^53 are not exact. Count frames, or time, from the first one."
            )
        require_shape(self.camera, (n,), "camera")
        require_boxes(n, self.box, self.score, self.keypoints)
        refuse(self.camera < 0, self.camera, "camera", "; indices start at 0.")
        fault = (
            f". Number cameras from 0, one after the other, up to {MOST_CAMERAS - 1}, or give "
            "their names to a reader."
        )
        refuse(self.camera >= MOST_CAMERAS, self.camera, "camera", fault)
        if self.ankles_confirmed is not None:
            require_shape(self.ankles_confirmed, (n,), "ankles_confirmed")
        if self.embedding is not None:
            require_shape(self.embedding, (n, None), "embedding")
            if n and self.embedding.shape[1] == 0:
                raise InvalidInputError(
                    f"embedding has shape ({n}, 0), but each row needs at least one number. "
                    "Pass None if there are no embeddings."
                )
            require_finite(self.embedding, "embedding")

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Any) -> "Detections":
        """Select rows by a slice, a boolean mask or an integer array, in that order."""
        return select_rows(self, len(self), rows)

    @property
    def height(self) -> Float[np.ndarray, " n"]:
        """(N,) box height in pixels."""
        return self.box[:, 3] - self.box[:, 1]

    @property
    def foot(self) -> Float[np.ndarray, "n 2"]:
        """(N, 2) bottom center of each box in pixels: the point that defines its ray."""
        return np.stack([(self.box[:, 0] + self.box[:, 2]) / 2, self.box[:, 3]], axis=-1)

    @classmethod
    def concatenate(cls, parts: "Iterable[Detections]") -> "Detections":
        """Concatenate detections, for instance those of several cameras.

        Args:
            parts: at least one. Parts without rows contribute only their clock.

        Raises:
            InvalidInputError: if there are no parts, only some parts have a column, embeddings have
                different lengths, or the clocks differ.
        """
        every = as_instances(parts, cls, "parts")
        if not every:
            raise InvalidInputError("concatenate needs at least one part, got none.")
        clocks = {part.clock for part in every}
        if len(clocks) > 1:
            raise InvalidInputError(
                "The parts have different clocks, so equal frame numbers are different times. Put "
                "them on one clock first, with cf.adapters.on_common_clock."
            )
        full = [part for part in every if len(part)] or every[:1]
        columns: dict[str, Any] = {}
        for name in (name for name in vars(full[0]) if name != "clock"):
            values = [getattr(part, name) for part in full]
            present = [value is not None for value in values]
            if any(present) and not all(present):
                raise InvalidInputError(
                    f"Part {present.index(False)} with rows has no {name}, but part "
                    f"{present.index(True)} has. Give it to all parts, or to none."
                )
            widths = {value.shape[1:] for value in values if value is not None}
            if len(widths) > 1:
                raise InvalidInputError(
                    f"{name} has {' and '.join(str(width[0]) for width in sorted(widths))} numbers "
                    "per row in different parts; take all from one embedder."
                )
            columns[name] = np.concatenate(values) if all(present) else None
        return cls(**columns, clock=every[0].clock)

    @classmethod
    def from_table(
        cls,
        table: Any,
        *,
        frame: str = "frame",
        camera: str | int = "camera",
        box: Sequence[str] = ("x1", "y1", "x2", "y2"),
        form: Literal["xyxy", "xywh"] = "xyxy",
        score: str | None = "score",
        camera_names: Sequence[str] | None = None,
        clock: Clock | None = None,
    ) -> "Detections":
        """Make detections from the columns of a table.

        Args:
            table: a pandas, polars or Arrow table, or a dictionary of columns; one row per box.
            frame: the column of frame numbers.
            camera: the column of camera indices, or of names if `camera_names` is given; an integer
                if all boxes belong to that camera.
            box: the four columns of the box, in pixels.
            form: "xyxy" for x1, y1, x2, y2; "xywh" for left, top, width, height.
            score: the column of confidences, or None; the default "score" may be absent.
            camera_names: (C,) names of the cameras in their order.
            clock: of the frames.

        Raises:
            InvalidInputError: if a column is missing, occurs twice, is longer than another, or has
                an empty or invalid value, a camera is not among `camera_names`, or the table is
                lazy.
        """
        names = _column_names(table)

        def column(name: str) -> np.ndarray:
            if name not in names:
                raise InvalidInputError(
                    f"The table has no column {quoted(name)}; it has "
                    f"{', '.join(map(quoted, names))}. Name the column to use."
                )
            if names.count(name) > 1:
                raise InvalidInputError(f"The table has several columns {quoted(name)}: keep one.")
            values = np.asarray(table[name])
            require_shape(values, (None,), f"The column {quoted(name)}")
            require_shape(values, (len(table[names[0]]),), f"The column {quoted(name)}")
            return values

        if len(box) != 4 or form not in ("xyxy", "xywh"):
            raise InvalidInputError(
                f"A box is four columns in the form 'xyxy' or 'xywh', got {quoted(tuple(box))} in "
                f"the form {quoted(form)}."
            )
        numbers = column(frame)
        if isinstance(camera, str):
            index = _camera_indices(column(camera), camera_names)
        else:
            index = np.full(len(numbers), as_count(camera, "camera"))
        corners = np.stack([as_float(column(name), name) for name in box], axis=-1)
        if form == "xywh":
            corners = np.concatenate([corners[:, :2], corners[:, :2] + corners[:, 2:]], axis=-1)
        scored = score is not None and (score in names or score != "score")
        return cls(
            numbers, index, corners, score=column(score) if scored and score else None, clock=clock
        )

    @classmethod
    def from_supervision(
        cls,
        boxes: Mapping[Any, Any],
        frame: int = 0,
        *,
        camera_names: Sequence[str] | None = None,
        clock: Clock | None = None,
    ) -> "Detections":
        """Make detections from `supervision.Detections`.

        Select the people first, for instance `boxes[boxes.class_id == 0]` if class 0 is people.

        Args:
            boxes: camera index, or name if `camera_names` is given, to the `supervision.Detections`
                of one image, or to a sequence of them, one per frame.
            frame: number of the first frame.
            camera_names: (C,) names of the cameras in their order.
            clock: of the frames.

        Raises:
            InvalidInputError: if a camera or its value has another type, only some boxes have
                confidences, or a camera is not among `camera_names`.
        """
        first = as_count(frame, "frame")
        keys = list(boxes) if isinstance(boxes, Mapping) else [boxes]
        for key in keys:
            if not isinstance(boxes, Mapping) or not isinstance(key, int | np.integer | str):
                raise InvalidInputError(
                    "boxes must be a dictionary from the index or name of each camera to its "
                    f"supervision.Detections, such as {{0: left, 1: right}}, got {quoted(key)}."
                )
        parts = []
        cameras = _camera_indices(np.array(keys), camera_names)
        for camera, camera_boxes in zip(cameras.tolist(), boxes.values(), strict=True):
            images = [camera_boxes] if hasattr(camera_boxes, "xyxy") else camera_boxes
            if not isinstance(images, Sequence):
                raise InvalidInputError(
                    f"Camera {camera} has a value of type {type(images).__name__} instead of "
                    "supervision.Detections or a sequence of them."
                )
            for number, image in enumerate(images, start=first):
                if not hasattr(image, "xyxy"):
                    raise InvalidInputError(
                        f"Camera {camera} has a value of type {type(image).__name__} in frame "
                        f"{number} instead of supervision.Detections."
                    )
                n = len(image.xyxy)
                camera_column, score = np.full(n, camera), image.confidence
                parts.append(cls(np.full(n, number), camera_column, image.xyxy, score, clock=clock))
        none = np.zeros(0, np.int64)
        return cls.concatenate(parts or [cls(none, none, np.zeros((0, 4)), clock=clock)])

    def to_pandas(self) -> "pandas.DataFrame":
        """Return frame, camera, x1, y1, x2, y2 and, if present, score as a pandas table.

        Raises:
            MissingDependencyError: if pandas is not installed.
        """
        pandas = require_pandas()
        columns = {"frame": self.frame, "camera": self.camera}
        columns |= dict(zip(("x1", "y1", "x2", "y2"), self.box.T, strict=True))
        if self.score is not None:
            columns["score"] = self.score
        return pandas.DataFrame(columns)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one `.npz` file (no pickle); `load` returns it bit for bit.

        Raises:
            InvalidInputError: if the folder does not exist.
            WriteError: if the disk is full or not writable.
        """
        save_arrays(path, "Detections", vars(self) | {"clock": clock_to_array(self.clock)})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Detections":
        """Read what `save` wrote.

        Raises:
            InvalidInputError: if there is no such file, or a row in it is invalid.
            FileFormatError: if the file holds something else.
        """
        arrays: dict[str, Any] = load_record(path, cls)
        with naming_file(path):
            # Files of versions 0.1 and 0.2 have no clock.
            return cls(**arrays | {"clock": clock_from_array(arrays.get("clock"))})


def is_confident(detections: Detections, least: float) -> Bool[np.ndarray, " n"]:
    """Mark the boxes with at least this score, (N,); all if they have none."""
    score = detections.score
    return np.ones(len(detections), bool) if score is None else score >= least


def concatenate_common(parts: Sequence[Detections]) -> Detections:
    """Concatenate detections, keeping only the columns that all parts with rows have.

    Raises:
        InvalidInputError: if embeddings have different lengths.
    """
    full = [part for part in parts if len(part)]
    lacking = {name for part in full for name, value in vars(part).items() if value is None}
    lacking.discard("clock")
    return Detections.concatenate([replace(part, **dict.fromkeys(lacking)) for part in parts])


def require_pandas() -> Any:
    """Import pandas.

    Raises:
        MissingDependencyError: if it is not installed.
    """
    with needing("Tables of pandas need pandas: pip install 'catfree[bridges]'."):
        import pandas
    return pandas


def _column_names(table: Any) -> list[str]:
    """List the columns of a pandas, polars or Arrow table, or of a dictionary."""
    if isinstance(table, Mapping):
        return list(table)
    if callable(getattr(table, "collect", None)):
        raise InvalidInputError("The table is lazy: pass table.collect() instead.")
    names = getattr(table, "column_names", getattr(table, "columns", None))
    if names is None or not hasattr(table, "__getitem__"):
        raise InvalidInputError(
            f"Expected a table of pandas, polars or Arrow, got {type(table).__name__}."
        )
    return list(names)


def _camera_indices(cameras: np.ndarray, names: Sequence[str] | None) -> np.ndarray:
    """Return the index of each camera, given by index or by name."""
    if names is None:
        if len(cameras) and cameras.dtype.kind in "OUST":
            raise InvalidInputError(
                f"Cameras are named, as {quoted(str(cameras[0]))}. Pass camera_names=, the names "
                "in the order of the scene's cameras."
            )
        return as_integer(cameras, "camera")
    if isinstance(names, str | set | frozenset) or not hasattr(names, "__len__"):
        raise InvalidInputError(
            f"camera_names must be a list of names in order, got {quoted(names)}."
        )
    index = {str(name): at for at, name in enumerate(names)}
    if len(index) < len(names):
        raise InvalidInputError(
            f"camera_names has a name twice: {shortened(', '.join(map(str, names)))}."
        )
    distinct, inverse = np.unique(cameras.astype(str), return_inverse=True)
    for name in distinct.tolist():
        if name not in index:
            raise InvalidInputError(
                f"There are boxes of camera {quoted(name)}, which is not among camera_names "
                f"({', '.join(index)})."
            )
    return np.array([index[name] for name in distinct.tolist()], np.int64)[inverse]
