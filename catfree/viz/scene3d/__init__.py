"""3-D scenes for other viewers."""
