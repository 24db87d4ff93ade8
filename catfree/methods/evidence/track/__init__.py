"""People over time: existence, motion, presence, one person per place."""
