"""Camera calibrations in the formats of other tools."""
