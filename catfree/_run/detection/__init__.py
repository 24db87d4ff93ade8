"""Finding people in the pictures of all cameras, twice, in pieces that later runs reuse."""
