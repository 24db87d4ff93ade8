"""Search for the rig: from pairs of cameras to all cameras."""
