"""The result of `Tracker.update`."""

from typing import Literal

import equinox as eqx

from catfree.types import Tracks


class Event(eqx.Module):
    """A correction of identities.

    Attributes:
        kind: "merge": the reported identity `old` turns out to be `new`, and does not occur again.
        time: seconds of the instant at which the two were joined.
        old: identity that ends.
        new: identity that continues.
    """

    kind: Literal["merge"]
    time: float
    old: int
    new: int


class Update(eqx.Module):
    """Positions after one more instant.

    Frame numbers of both tables are microseconds, which their clock converts to seconds:
    `tracks.time` is the time passed to `update`. `support` refers to rows of the detections passed
    with that instant.

    Attributes:
        provisional: positions of this instant; later instants may correct them.
        final: positions of all instants that this call made final, in order of time. No other call
            returns rows of these instants, and their identities no longer change.
        events: corrections of identities, in order of time.
        final_until: seconds; instants up to this time are final, with or without people.
    """

    provisional: Tracks
    final: Tracks
    events: tuple[Event, ...]
    final_until: float
