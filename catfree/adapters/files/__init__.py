"""Reading and writing text, JSON and array files."""
