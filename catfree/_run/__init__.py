"""From videos to tracks: stages, cache, second look, report, result folder, and shards."""
