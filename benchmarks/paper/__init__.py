"""All tables of the paper, with its numbers beside ours: `python -m benchmarks.paper.all`."""
