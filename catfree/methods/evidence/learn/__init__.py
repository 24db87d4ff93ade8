"""Noise, offsets and detection rates learned from the sequence."""
