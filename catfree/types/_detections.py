"""Person detections: boxes with optional scores, ankles, appearance and keypoints."""

import os
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.errors import InvalidInputError
from catfree.types._archive import load_arrays, naming_file, save_arrays
from catfree.types._clock import Clock, clock_from_array, clock_to_array, require_clock
from catfree.types._validation import (
    as_boolean,
    as_float,
    as_integer,
    first_index,
    require_finite,
    require_shape,
)

WIDEST_SPAN = 2**53  # frames; larger differences are not exact floats (104 days in nanoseconds)


class Detections(eqx.Module):
    """Person detections of all cameras and frames, one row each, in any order.

    Attributes:
        frame: (N,) int64, the synchronized frame (time index) of each box; any integers
            less than 2^53 apart.
        camera: (N,) int64, index into the rig's cameras, 0-based.
        box: (N, 4) x1, y1, x2, y2 in original image pixels, the center of the top-left pixel at
            (0, 0); float dtype is kept, other numbers become float64.
        score: (N,) detector confidence in [0, 1], or None.
        ankles_confirmed: (N,) whether both ankle keypoints were detected, or None if no pose
            estimator ran.
        embedding: (N, D) appearance vector, L2-normalized by its embedder, or None.
        keypoints: (N, 17, 3) COCO keypoints as x, y in pixels and confidence, or None.
        clock: gives the time of each frame, or None if unknown.
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
            InvalidInputError: naming the first entry that has a wrong shape, a value that is not
                finite, a box without area, a negative camera or a score outside [0, 1]; or if the
                frames span 2^53 or more.
        """
        self.frame = as_integer(frame, "frame")
        self.camera = as_integer(camera, "camera")
        boxes = np.asarray(as_float(box))
        self.box = boxes.reshape(0, 4) if boxes.size == 0 else boxes
        self.score = None if score is None else np.asarray(as_float(score))
        self.ankles_confirmed = (
            None if ankles_confirmed is None else as_boolean(ankles_confirmed, "ankles_confirmed")
        )
        self.embedding = None if embedding is None else np.asarray(as_float(embedding))
        if self.embedding is not None and self.embedding.shape == (0,):
            self.embedding = self.embedding.reshape(0, 0)
        self.keypoints = None if keypoints is None else np.asarray(as_float(keypoints))
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
        require_shape(self.box, (n, 4), "box")
        require_finite(self.box, "box")
        if (self.camera < 0).any():
            at = first_index(self.camera < 0)
            raise InvalidInputError(f"camera[{at}] is {self.camera[int(at)]}; indices start at 0.")
        empty = (self.box[:, 2] <= self.box[:, 0]) | (self.box[:, 3] <= self.box[:, 1])
        if empty.any():
            at = int(np.argmax(empty))
            raise InvalidInputError(
                f"box[{at}] is {self.box[at].tolist()}; it must be x1 < x2, y1 < y2 in pixels "
                "(xyxy, not xywh)."
            )
        if self.score is not None:
            require_shape(self.score, (n,), "score")
            require_finite(self.score, "score")
            outside = (self.score < 0) | (self.score > 1)
            if outside.any():
                at = int(np.argmax(outside))
                raise InvalidInputError(f"score[{at}] is {self.score[at]}; it must be in [0, 1].")
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
        if self.keypoints is not None:
            require_shape(self.keypoints, (n, 17, 3), "keypoints")
            require_finite(self.keypoints, "keypoints")

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Any) -> "Detections":
        """Select rows by a slice, a boolean mask or an integer array, in that order."""
        chosen = np.arange(len(self))[rows].reshape(-1)
        columns = {name: value for name, value in vars(self).items() if name != "clock"}
        return Detections(
            **{name: None if value is None else value[chosen] for name, value in columns.items()},
            clock=self.clock,
        )

    @property
    def height(self) -> Float[np.ndarray, " n"]:
        """(N,) box height in pixels."""
        return self.box[:, 3] - self.box[:, 1]

    @property
    def foot(self) -> Float[np.ndarray, "n 2"]:
        """(N, 2) bottom center of each box in pixels: the point that defines its ray."""
        return np.stack([(self.box[:, 0] + self.box[:, 2]) / 2, self.box[:, 3]], axis=-1)

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
        # Files of versions 0.1 and 0.2 have no clock.
        optional = ("score", "ankles_confirmed", "embedding", "keypoints", "clock")
        required = ("frame", "camera", "box")
        arrays = load_arrays(path, "Detections", required=required, optional=optional)
        columns = {name: array for name, array in arrays.items() if name != "clock"}
        return naming_file(
            path, lambda: cls(**columns, clock=clock_from_array(arrays.get("clock")))
        )
