"""Build a scene, one rig and one ground, from reconstructions of single instants."""
