"""People seen by several cameras, and whether a camera agrees with the others."""
