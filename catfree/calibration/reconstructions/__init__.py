"""A scene from reconstructions of single instants: one rig, one ground."""
