"""CPU seconds by stage of both methods (Sec. Runtime): `python -m benchmarks.paper.runtime`.

CPU seconds are those of all threads in a warm run, so other load on the machine does not count. The
paper's seconds are wall time on a workstation with an RTX A6000.
"""

import time

import catfree as cf
from benchmarks.paper import claims
from benchmarks.paper.command import Options, main
from benchmarks.paper.sequences import TWINS, Sequence, twin
from benchmarks.paper.table import Cell, Table
from benchmarks.paper.variants import BT, EVIDENCE

# Wall seconds from detection through tracking; GMVD: 158 to 230.
PAPER = {"WildTrack": "135", "MultiviewX": "237", "GMVD": "158-230", "GMVD c2": ""}
STAGES = ("tracklets", "association", "positions", "selection", "trajectories")
PAPER_SHARE = (61, 71)  # percent of the time spent in association
METHODS = {"paper's method": BT, "evidence method": EVIDENCE}


def stage_seconds(sequence: Sequence, settings: cf.Settings) -> dict[str, float]:
    """Measure CPU seconds of each stage of a warm run, by the names that progress reports."""
    cf.localize(sequence.detections, sequence.scene, settings)
    marks = [("preparation", time.process_time())]

    def record(stage: str, done: int, total: int) -> None:
        marks.append((stage, time.process_time()))

    cf.localize(sequence.detections, sequence.scene, settings, record)
    ends = [mark for _, mark in marks[1:]] + [time.process_time()]
    seconds: dict[str, float] = {}
    for (stage, begin), end in zip(marks, ends, strict=True):
        seconds[stage] = seconds.get(stage, 0.0) + end - begin
    return seconds


def table(options: Options) -> Table:
    """Tabulate one row per twin and method, from the first seed."""
    rows: list[list[Cell]] = []
    share: dict[str, float] = {}
    for made in TWINS:
        sequence = twin(made.paper, options.seeds[0], options.frames)
        for method, settings in METHODS.items():
            seconds = stage_seconds(sequence, settings)
            total = sum(seconds.values())
            each = [f"{seconds[stage]:.2f}" if stage in seconds else "-" for stage in STAGES]
            rest = total - sum(seconds.get(stage, 0.0) for stage in STAGES)
            if settings is BT:
                share[made.paper] = 100 * seconds["association"] / total
            rows.append(
                [
                    f"{made.layout} twin",
                    method,
                    len(sequence.frames),
                    len(sequence.detections),
                    PAPER[made.paper] if settings is BT else "",
                    f"{total:.2f}",
                    *each,
                    f"{rest:.2f}",
                ]
            )
    low, _ = PAPER_SHARE
    return Table(
        "CPU seconds of `cf.localize`, warm (paper: Sec. Runtime)",
        ["Data", "Method", "Frames", "Boxes", "Paper, wall s", "Total", *STAGES, "other stages"],
        rows,
        verdicts=(
            claims.holds_in(
                f"Association takes {low} % of the time or more",
                {place: value >= low for place, value in share.items()},
                {place: f"{value:.0f} %" for place, value in share.items()},
            ),
        ),
    )


if __name__ == "__main__":
    main(table, "runtime", __doc__ or "")
