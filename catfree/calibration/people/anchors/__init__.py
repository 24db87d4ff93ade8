"""Anchors: independent measurements of a site, and their relation to cameras."""
