"""Track people over time: existence, motion, presence, and one person per position."""
