"""Tracking while the cameras record."""

from catfree.methods.online._instant_assembler import (
    DroppedFrame as DroppedFrame,
    Instant as Instant,
    InstantAssembler as InstantAssembler,
)

__all__ = ["DroppedFrame", "Instant", "InstantAssembler"]
