"""Networks that reconstruct cameras from pictures."""

from catfree.adapters.reconstructors._vggt import (
    VggtOnnx as VggtOnnx,
)
