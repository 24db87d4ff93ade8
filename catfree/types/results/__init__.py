"""Results: tracks, the localization that they are part of, and reconstructions."""
