"""Embeddings as unit vectors, made on demand because those of all boxes would fill memory."""

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

BLOCK = 4096  # embeddings measured together
LEAST_LENGTH = 1e-12  # of an embedding; shorter ones carry no information


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Embeddings:
    """Embeddings of boxes: rows of the caller's array.

    Attributes:
        raw: (M, D) embeddings of all detections, of any norm.
        row: (N,) row of `raw` of each box.
        length: (N,) Euclidean norm; 0 for boxes without an embedding.
    """

    raw: Float[np.ndarray, "detection dim"]
    row: Int[np.ndarray, " box"]
    length: Float[np.ndarray, " box"]

    @property
    def dim(self) -> int:
        """Numbers per embedding."""
        return self.raw.shape[1]

    def __getitem__(self, boxes: Any) -> Float[np.ndarray, "*n dim"]:
        """Unit vectors of boxes in single precision, which suffices; 0 without an embedding."""
        raw, length = self.raw[self.row[boxes]], np.maximum(self.length[boxes], LEAST_LENGTH)
        unit = np.empty(raw.shape, np.float32)
        return np.divide(raw, length[..., None], out=unit, dtype=np.float64, casting="same_kind")

    def exists(self, boxes: Int[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
        """Return whether each of these boxes has an embedding."""
        return self.length[boxes] > 0

    def of_boxes(self, boxes: slice) -> "Embeddings":
        """Those of some boxes alone, which are counted from the first of them."""
        return Embeddings(self.raw, self.row[boxes], self.length[boxes])


def embeddings_of(
    raw: Float[np.ndarray, "detection dim"], row: Int[np.ndarray, " box"]
) -> Embeddings:
    """Compute the norms of the embeddings of these rows."""
    blocks = [row[begin : begin + BLOCK] for begin in range(0, len(row), BLOCK)]
    lengths = [np.linalg.norm(raw[block].astype(np.float64), axis=1) for block in blocks]
    return Embeddings(raw, row, np.concatenate([np.zeros(0), *lengths]))
