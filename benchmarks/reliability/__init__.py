"""Check that damaged files, attacks, kills, full disks and odd names give one-sentence errors.

    python -m benchmarks.reliability [--short] [--seed N]

All inputs come from a tiny synthetic world; no data set is needed.
"""
