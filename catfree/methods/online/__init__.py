"""Tracking while the cameras record: from frames to instants, to positions, to records."""

from catfree.methods.online._instant_assembler import (
    DroppedFrame as DroppedFrame,
    Instant as Instant,
    InstantAssembler as InstantAssembler,
)
from catfree.methods.online._tracker import Tracker as Tracker
from catfree.methods.online._tracker_state import TrackerState as TrackerState
from catfree.methods.online._update import Event as Event, Update as Update
from catfree.methods.online._watch import watch as watch

__all__ = [
    "DroppedFrame",
    "Event",
    "Instant",
    "InstantAssembler",
    "Tracker",
    "TrackerState",
    "Update",
    "watch",
]
