"""Tracking while the video runs: one instant in, positions of now and final ones of a while ago."""

from catfree.methods.online._tracker import Tracker as Tracker
from catfree.methods.online._tracker_state import TrackerState as TrackerState
from catfree.methods.online._update import Event as Event, Update as Update
