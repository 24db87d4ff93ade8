"""Data sets, and files of boxes, calibrations and ground truth whose format is found out."""
