"""Triangulation of a point from many rays, some of them wrong."""
