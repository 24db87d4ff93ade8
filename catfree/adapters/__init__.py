"""Foreign things in and out: data sets, calibration files, track files, and neural networks."""

# Files and data sets.
from catfree.adapters.scenario import read_scenario as read_scenario
from catfree.adapters.sequence import MultiViewSequence as MultiViewSequence
from catfree.adapters.uniform_json import read_uniform_json as read_uniform_json
