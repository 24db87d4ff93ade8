"""Results: tracks, localizations and reconstructions."""
