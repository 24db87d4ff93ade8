"""From videos to tracks: stages, cache, detection, report, result folder, and shards."""
