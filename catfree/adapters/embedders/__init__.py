"""Appearance embeddings."""

from catfree.adapters.embedders._color_embedder import (
    ColorEmbedder as ColorEmbedder,
)
from catfree.adapters.embedders._reid import (
    ReIdOnnx as ReIdOnnx,
)
