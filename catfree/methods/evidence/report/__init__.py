"""Select what is reported, and compute its uncertainty."""
