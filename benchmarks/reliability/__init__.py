"""Damaged files, attacks, kills, full disks and odd names: does every failure end in one sentence?

    python -m benchmarks.reliability [--short] [--seed N]

Everything is made from a tiny synthetic world; no data set is needed.
"""
