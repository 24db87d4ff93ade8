"""COLMAP reconstructions: text and binary in, text out."""
