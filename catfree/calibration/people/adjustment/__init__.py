"""Bundle adjustment of cameras and people."""
