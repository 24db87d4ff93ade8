"""Networks that reconstruct cameras from pictures."""
