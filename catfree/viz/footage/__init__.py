"""Drawings on the footage with OpenCV."""
