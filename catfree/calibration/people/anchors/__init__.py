"""Anchors: what is known about a site from elsewhere, and what it says about cameras."""
