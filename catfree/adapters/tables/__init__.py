"""Tracks and boxes as tables."""
