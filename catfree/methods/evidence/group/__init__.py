"""Group the boxes of one instant into people."""
