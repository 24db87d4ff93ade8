"""The detector that needs no weights: people against a learned background."""

from catfree.adapters.background._background_detector import (
    BackgroundDetector as BackgroundDetector,
)
