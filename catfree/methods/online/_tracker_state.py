"""All that a `Tracker` remembers."""

import os

import equinox as eqx


class TrackerState(eqx.Module):
    """All that a `Tracker` remembers: a pytree of arrays whose size does not grow with time."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one `.npz` file (no pickle); `load` returns it bit for bit."""
        raise NotImplementedError

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "TrackerState":
        """Read what `save` wrote."""
        raise NotImplementedError
