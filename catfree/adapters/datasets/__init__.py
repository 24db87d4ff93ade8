"""Data sets with detections, calibration and ground truth."""

from catfree.adapters.datasets._multiviewx import (
    read_multiviewx as read_multiviewx,
)
from catfree.adapters.datasets._scenario import (
    read_scenario as read_scenario,
)
from catfree.adapters.datasets._sequence import (
    MultiViewSequence as MultiViewSequence,
)
from catfree.adapters.datasets._uniform_json import (
    read_uniform_json as read_uniform_json,
)
from catfree.adapters.datasets._wildtrack import (
    read_wildtrack as read_wildtrack,
)
