"""Models of one camera: parameters, map of the ground, single-view calibration."""
