"""COLMAP reconstructions: text and binary in, text out."""

from catfree.adapters.calibration_files.colmap._colmap import (
    read_colmap as read_colmap,
    write_colmap_text as write_colmap_text,
)
