"""Cache of packed foregrounds, because the same pictures are processed more than once."""

import hashlib
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, UInt8

from catfree.adapters.background._background_model import Foreground
from catfree.adapters.protocols import Image

MEMORY = 64 * 2**20  # bytes per camera: hundreds of pictures


class ForegroundMemory:
    """A cache of the foregrounds of one camera's pictures.

    Computing a foreground takes longer than all other steps for a picture. The first pictures are
    kept until the cache is full; the others are computed again each time, with equal results.
    """

    def __init__(self, compare: Callable[[Image], Foreground], limit: int = MEMORY) -> None:
        """Start empty.

        Args:
            compare: finds the foreground of a picture, as `BackgroundModel.compare` does.
            limit: bytes that may be kept.
        """
        self._compare, self._limit, self._size = compare, limit, 0
        self._kept: dict[
            bytes, tuple[UInt8[np.ndarray, " packed"], Float[np.ndarray, " inside"]]
        ] = {}

    def __call__(self, picture: Image) -> Foreground:
        """Return the foreground of a reduced picture."""
        key = hashlib.sha256(np.ascontiguousarray(picture).data).digest()
        stored = self._kept.get(key)
        if stored is not None:
            return _unpack(*stored, picture.shape[:2])
        foreground = self._compare(picture)
        inside = foreground.mask > 0
        packed = np.packbits(inside), foreground.difference[inside]
        size = sum(part.nbytes for part in packed)
        if self._size + size <= self._limit:
            self._kept[key] = packed
            self._size += size
        return foreground


def _unpack(
    bits: UInt8[np.ndarray, " packed"],
    inside: Float[np.ndarray, " inside"],
    shape: tuple[int, ...],
) -> Foreground:
    mask = np.unpackbits(bits, count=shape[0] * shape[1]).reshape(shape)
    difference = np.zeros(shape, inside.dtype)
    difference[mask > 0] = inside
    return Foreground(mask, difference)
