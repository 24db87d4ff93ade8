"""Detect people in the pictures of all cameras, in two passes that are cached in pieces."""
