"""Boxes of one instant grouped into people."""
