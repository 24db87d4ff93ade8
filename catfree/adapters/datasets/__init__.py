"""Data sets, and readers of boxes, calibrations and ground truth that detect the format."""
