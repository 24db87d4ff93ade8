"""Make all tables in turn: `python -m benchmarks.paper.all --data DATA --out FOLDER`."""

import importlib
import time

from benchmarks.paper.command import parse

TABLES = (
    "twins",
    "main_results",
    "gates",
    "gates_unseen",
    "baselines",
    "score_stage",
    "lineage",
    "trajectory_rules",
    "quantile",
    "coverage",
    "failure",
    "runtime",
    "camera_removal",
    "sigma_curve",
    "heldout",
    "unseen_rig",
    "leave_one_out",
)


def main() -> None:
    """Make all tables, printing and writing each when it is ready."""
    options, out = parse(__doc__ or "")
    claims = ["# What the tables say about the paper's claims", ""]
    for name in TABLES:
        start = time.process_time()
        table = importlib.import_module(f"benchmarks.paper.{name}").table(options)
        print(table.markdown())
        print(f"({name}: {time.process_time() - start:.0f} CPU seconds)\n", flush=True)
        claims += [f"## {table.title}", "", *(f"- {verdict}" for verdict in table.verdicts), ""]
        if out is not None:
            table.write(out, name)
            (out / "claims.md").write_text("\n".join(claims), encoding="utf-8")


if __name__ == "__main__":
    main()
