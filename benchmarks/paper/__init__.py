"""Every table of the paper, its numbers beside ours: `python -m benchmarks.paper.all`."""
