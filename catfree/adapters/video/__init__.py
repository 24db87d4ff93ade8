"""Synchronized videos, and detections from them."""
