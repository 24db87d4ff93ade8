"""Select the positions to report, and compute their uncertainty."""
