"""Run all checks, print the table, and fail if any check fails."""

import argparse
import faulthandler
import resource
import sys
import tempfile
from pathlib import Path

from benchmarks.reliability.attacks import attack
from benchmarks.reliability.disks import full_disks
from benchmarks.reliability.fuzz import decay, fuzz
from benchmarks.reliability.kills import kill
from benchmarks.reliability.names import odd_names
from benchmarks.reliability.shard_kills import kill_shards
from benchmarks.reliability.tally import Tally

MEMORY = 24 * 2**30  # bytes of address space: an unbounded allocation is an error, not a crash
STUCK = 600  # seconds, for code that no signal interrupts


def main() -> int:
    """Run the command line; return 1 after a traceback, a silent NaN, a hang or a loss."""
    parser = argparse.ArgumentParser(prog="benchmarks.reliability", description=__doc__)
    parser.add_argument("--short", action="store_true", help="a small part, in a minute or two")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    tally = Tally()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        parts = (
            ("fuzz", lambda p: fuzz(tally, p, options.seed, 5 if options.short else 760)),
            ("decay", lambda p: decay(tally, p, options.seed, 10 if options.short else 1200)),
            ("attacks", lambda p: attack(tally, p)),
            ("names", lambda p: odd_names(tally, p, pictures=not options.short)),
            ("kills", lambda p: kill(tally, p, options.seed, 1 if options.short else 30)),
            ("disks", lambda p: full_disks(tally, p, 2 if options.short else 15)),
        )
        if not options.short:  # each kill takes half a minute
            parts += (("shards", lambda p: kill_shards(tally, p, options.seed, 50)),)
        for name, run in parts:
            (root / name).mkdir()
            faulthandler.dump_traceback_later(STUCK * (1 if options.short else 10), exit=True)
            run(root / name)
            print(f"{name}: {tally.failures} failures so far", file=sys.stderr, flush=True)
        faulthandler.cancel_dump_traceback_later()
    print(tally)
    return 1 if tally.failures else 0


if __name__ == "__main__":
    sys.exit(main())
