"""What one call of `Tracker.update` returns."""

from typing import Literal

import equinox as eqx

from catfree.types import Tracks


class Event(eqx.Module):
    """A correction of identities.

    Attributes:
        kind: "merge": identity `old` was reported and turns out to be `new`; it does not occur
            again.
        time: seconds of the instant at which the two met.
        old: identity that ends.
        new: identity that continues.
    """

    kind: Literal["merge"]
    time: float
    old: int
    new: int


class Update(eqx.Module):
    """Positions after one more instant.

    Frame numbers of both tables are microseconds, and their clock turns these into seconds:
    `tracks.time` is the time that was passed to `update`. `support` counts the rows of the
    detections that were passed with that instant.

    Attributes:
        provisional: positions of this instant; later instants may correct them.
        final: positions of all instants that became final by this call, in order of time. No
            other call returns rows of these instants, and identities are not corrected any more.
        events: corrections of identities, in order of time.
        final_until: seconds; instants up to this time are final, with people or without.
    """

    provisional: Tracks
    final: Tracks
    events: tuple[Event, ...]
    final_until: float
