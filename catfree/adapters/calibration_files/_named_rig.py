"""The content of a calibration file: a rig, the names of its cameras, and optional points."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Num

from catfree.adapters.calibration_files._distortion import (
    distortion_of,
    require_coefficients,
    require_undistorted,
)
from catfree.adapters.files._camera_names import numbered_names
from catfree.adapters.files._documents import StrPath, naming_file
from catfree.errors import InvalidInputError
from catfree.types import Lens, Rig
from catfree.types._validation import require_instance, require_names

_IDEAL = np.zeros(8)


class FileCamera(NamedTuple):
    """One camera of a calibration file, as the fields of `Rig`.

    Attributes:
        K: (3, 3).
        R: (3, 3).
        t: (3,).
        image_size: (2,) width and height in pixels.
        distortion: (8,) coefficients, zero where the file has fewer.
        lens: their model.
    """

    K: Float[np.ndarray, "3 3"]
    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, "3"]
    image_size: Num[np.ndarray, "2"] | tuple[int, int]
    distortion: Float[np.ndarray, "8"] = _IDEAL
    lens: Lens = Lens.PINHOLE


def rig_of(cameras: Sequence[FileCamera], source: StrPath) -> Rig:
    """Join the cameras of a file to a rig; errors name the file."""
    K, R, t, size, distortion, lens = zip(*cameras, strict=True)
    K, R, t, size = (np.stack(part) for part in (K, R, t, size))
    with naming_file(source):
        return Rig(K, R, t, size, distortion_of(distortion), lens=lens)


@dataclasses.dataclass(frozen=True, eq=False)
class NamedRig:
    """Cameras of one calibration file, in the file's order.

    Attributes:
        rig: the cameras, world-to-camera, in the file's units of length.
        names: (C,) their names.
        points: (P, 3) reconstructed points in the same frame, or None.
    """

    rig: Rig
    names: tuple[str, ...]
    points: Float[np.ndarray, "p 3"] | None = None

    def __post_init__(self) -> None:
        """Raise InvalidInputError if the names do not match the cameras; see `default_names`."""
        default_names(self.rig, self.names)


def default_names(rig: Rig, names: Sequence[str] | None) -> tuple[str, ...]:
    """Return the given names, or C1, C2, ... if None.

    Raises:
        InvalidInputError: if they are not a list, there are not as many names as cameras, two are
            equal, or one is not text.
    """
    require_instance(rig, Rig, "rig")
    require_names(names, rig.camera_count, "names", distinct=True)
    return numbered_names(rig.camera_count) if names is None else tuple(names)


def writable_cameras(
    rig: Rig, names: Sequence[str] | None, target: StrPath, *, ideal: bool = False
) -> tuple[Rig, tuple[str, ...]]:
    """Select the registered cameras in float64, for formats that cannot hold others.

    Args:
        rig: the cameras.
        names: (C,) names; C1, C2, ... if None.
        target: what is written, for messages.
        ideal: whether the format has no coefficients of a lens.

    Raises:
        InvalidInputError: if no camera is registered, the names do not match the cameras, or a
            registered one has a lens that the format cannot hold.
    """
    require_instance(rig, Rig, "rig")
    registered = np.flatnonzero(rig.registered)
    if len(registered) == 0:
        raise InvalidInputError(f"Cannot write {target}: no camera of the rig is registered.")
    labels = default_names(rig, names)
    selected = rig.select(registered)
    names_of_floats = ("K", "R", "t", "distortion", "rays")
    columns = {name: getattr(selected, name) for name in names_of_floats}
    exact = dataclasses.replace(
        selected,
        **{k: None if v is None else np.asarray(v, np.float64) for k, v in columns.items()},
    )
    chosen = tuple(labels[camera] for camera in registered)
    (require_undistorted if ideal else require_coefficients)(exact, chosen, target)
    return exact, chosen
