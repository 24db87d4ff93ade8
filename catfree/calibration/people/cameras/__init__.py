"""One camera: its parameters, its map of the ground, what a single view tells."""
