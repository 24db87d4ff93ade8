"""Ground truth and predictions as rows [frame, id, x, y], checked and grouped by frame."""

from collections.abc import Iterator, Set
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from catfree.errors import InvalidInputError
from catfree.geometry._arrays import ArrayInput
from catfree.types._validation import as_float, as_integer, refuse

Number = float | int | np.number
Rows = Float[np.ndarray, "n 4"]
Frames = ArrayInput | Set[int | np.integer]
_COLUMNS = ["frame", "id", "x", "y"]


def as_rows(rows: ArrayInput, name: str, *, identified: bool = False) -> Rows:
    """Check rows and convert them to an (N, 4) float64 array.

    Args:
        rows: (N, 4) frame, identity, x, y in meters; anything empty counts as (0, 4).
        name: name of the rows in error messages.
        identified: require identities to be whole numbers below 2^53, each at most once per frame.

    Returns:
        (N, 4) float64.

    Raises:
        InvalidInputError: naming the first invalid row.
    """
    names = [str(one) for one in getattr(rows, "columns", ())]
    if names != _COLUMNS and sorted(names) == sorted(_COLUMNS):
        raise InvalidInputError(
            f"{name} has the columns {names}; pass those of {_COLUMNS}, in this order."
        )
    try:
        array = np.asarray(as_float(rows), np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(
            f"{name} must be an (N, 4) array of numbers [frame, id, x, y]. {error}"
        ) from error
    if array.size == 0:
        return np.zeros((0, 4))
    if array.ndim != 2 or array.shape[1] != 4:
        raise InvalidInputError(
            f"{name} must have shape (N, 4) with columns [frame, id, x, y], got {array.shape}."
        )
    refuse(~np.isfinite(array).all(axis=1), array, name, ": all four values must be finite.")
    whole = array[:, :2] if identified else array[:, :1]
    columns = "frame and id" if identified else "frame"
    fractional = (whole != np.round(whole)).any(axis=1)
    refuse(fractional, array, name, f": {columns} must be whole numbers.")
    too_large = np.abs(array[:, 0]) >= 2.0**63
    refuse(too_large, array, name, ": its frame must be a whole number of at most 63 bits.")
    if identified:
        inexact = np.abs(array[:, 1]) >= 2.0**53
        refuse(inexact, array, name, ": its id must be below 2^53. Number people from 0.")
        _, first = np.unique(array[:, :2], axis=0, return_index=True)
        repeated = np.ones(len(array), dtype=bool)
        repeated[first] = False
        fault = ": its id is already in this frame; give every person one row."
        refuse(repeated, array, name, fault)
    return array


@dataclass(frozen=True, eq=False)
class Sequence:
    """Ground truth and predictions over one list of frames, both in their input order.

    Attributes:
        frames: (F,) the evaluated frames, ascending.
        truth: (G, 4) ground-truth rows of those frames.
        predicted: (P, 4) predicted rows of those frames.
        truth_rows: for each frame, the indices of its rows in `truth`.
        predicted_rows: for each frame, the indices of its rows in `predicted`.
    """

    frames: Int[np.ndarray, " f"]
    truth: Float[np.ndarray, "g 4"]
    predicted: Float[np.ndarray, "p 4"]
    truth_rows: list[np.ndarray]
    predicted_rows: list[np.ndarray]

    def __iter__(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Iterate over frames: the indices of their true and of their predicted rows."""
        return zip(self.truth_rows, self.predicted_rows, strict=True)

    def distances(
        self, truth: Int[np.ndarray, " g"], predicted: Int[np.ndarray, " p"]
    ) -> Float[np.ndarray, "g p"]:
        """(g, p) Euclidean distances in meters between the rows with these indices."""
        difference = self.truth[truth, None, 2:] - self.predicted[None, predicted, 2:]
        return np.linalg.norm(difference, axis=-1)


def read_sequence(
    ground_truth: ArrayInput,
    predictions: ArrayInput,
    frames: Frames | None = None,
    *,
    identified: bool = False,
) -> Sequence:
    """Check both row arrays and group them by frame.

    Args:
        ground_truth: (G, 4) rows [frame, id, x, y], meters.
        predictions: (P, 4) rows of the same form, in the same coordinates.
        frames: the frames to evaluate. A listed frame without rows contributes nothing; in a frame
            where only one of the two arrays has rows, every row is an error. Rows of other frames
            are ignored. None evaluates every frame that either array mentions.
        identified: whether identities matter (see `as_rows`).

    Returns:
        The checked sequence.

    Raises:
        InvalidInputError: naming the first bad row or frame.
    """
    truth = as_rows(ground_truth, "ground_truth", identified=identified)
    predicted = as_rows(predictions, "predictions", identified=identified)
    if frames is None:
        listed = np.concatenate([truth[:, 0], predicted[:, 0]]).astype(np.int64)
    else:
        listed = as_integer(list(frames) if isinstance(frames, range | Set) else frames, "frames")
        if listed.ndim != 1:
            raise InvalidInputError(f"frames must be a flat list, got shape {listed.shape}.")
    listed = np.unique(listed)
    truth = truth[np.isin(truth[:, 0], listed)]
    predicted = predicted[np.isin(predicted[:, 0], listed)]
    return Sequence(
        frames=listed,
        truth=truth,
        predicted=predicted,
        truth_rows=_by_frame(truth, listed),
        predicted_rows=_by_frame(predicted, listed),
    )


def _by_frame(rows: Rows, frames: np.ndarray) -> list[np.ndarray]:
    order = np.argsort(rows[:, 0], kind="stable")
    if not len(frames):
        return []
    return np.split(order, np.searchsorted(rows[order, 0], frames[1:]))
