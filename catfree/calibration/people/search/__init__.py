"""From pairs of cameras to the whole rig."""
