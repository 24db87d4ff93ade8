"""Detector without weights: background subtraction."""
