"""Long recordings in shards: cut, localize each on any executor, join the identities."""
