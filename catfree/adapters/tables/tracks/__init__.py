"""Tracks in the forms of other programs: pedestrian dynamics, maps, benchmarks, behavior."""
