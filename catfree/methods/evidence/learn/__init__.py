"""Learn noise and offsets from the sequence."""
