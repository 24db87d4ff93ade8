"""The detector that needs no weights: people against a learned background."""
