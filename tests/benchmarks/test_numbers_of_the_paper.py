"""The paper's numbers in `benchmarks/paper` are those of the paper's tables."""

import importlib
import re
from functools import cache
from pathlib import Path

import pytest

from benchmarks import failure_table
from benchmarks.paper import coverage, main_results, runtime, score_stage, twins

TABLES = {
    "main_results": "main",
    "gates": "gates",
    "gates_unseen": "gatesunseen",
    "baselines": "baselines",
    "lineage": "lineage",
    "trajectory_rules": "traj",
    "quantile": "quantile",
}
NUMBER = re.compile(r"^[+-]?\d+(\.\d+)?$")


@pytest.fixture
def paper(shared) -> str:
    path = shared / "paper.txt"
    if not path.is_file():
        pytest.skip(f"{path} not found: it holds the paper's text")
    return text(path)


@cache
def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def rows_of(paper: str, label: str) -> list[list[str]]:
    """Return the cells of a table's rows with numbers, without markup."""
    found = re.search(r"\\label\{tab:" + label + r"\}(.*?)\\end\{tabular\}", paper, re.DOTALL)
    assert found is not None, label
    rows = []
    for line in found[1].split(r"\\"):
        plain = re.sub(r"\\(textbf|mathbf)\{([^}]*)\}", r"\2", line)
        plain = plain.replace("{,}", "").replace("$", "")
        cells = [cell.strip() for cell in plain.split("&")]
        if any(NUMBER.match(cell) for cell in cells):
            rows.append(cells)
    return rows


def numbers(row: list[str]) -> list[float]:
    return [float(cell) for cell in row if NUMBER.match(cell)]


@pytest.mark.parametrize("name", TABLES)
def test_every_row_has_the_papers_numbers(paper, name):
    module = importlib.import_module(f"benchmarks.paper.{name}")
    said = [numbers(row) for row in rows_of(paper, TABLES[name])]
    assert len(said) == len(module.PAPER)
    for (label, ours), theirs in zip(module.PAPER.items(), said, strict=True):
        assert list(ours) == theirs[: len(ours)], label


def test_coverage_by_stage(paper):
    rows = rows_of(paper, "coverage")
    # The last row has the gain from fixing near misses in brackets, and is not a row of numbers.
    assert [numbers(row) for row in rows] == [list(v) for v in list(coverage.PAPER.values())[:-1]]
    fixed = re.search(r"MODA if all were fixed(.*)", paper)
    assert fixed is not None
    gained = [float(value) for value in re.findall(r"\(\+([\d.]+)\)", fixed[1])]
    assert gained == list(coverage.PAPER[coverage.FIXED])
    assert "0.952 on WildTrack and 0.788 on MultiviewX" in paper
    assert coverage.PAPER_SEPARATION[coverage.AUC][:2] == (0.952, 0.788)
    assert r"about 90\% of false-positive candidates" in paper


def test_incorrect_pairs(paper):
    said = [numbers(row) for row in rows_of(paper, "failure")]
    ours = [list(row) for rows in failure_table.PAPER.values() for row in rows]
    assert said == ours


def test_what_the_text_says(paper):
    change = re.search(r"changes MODA by \$\+([\d.]+)\$, \$\+([\d.]+)\$, and \$\+([\d.]+)\$", paper)
    assert change is not None
    assert tuple(map(float, change.groups())) == score_stage.PAPER_CHANGE[:3]
    assert re.search(rf"\$\+{score_stage.PAPER_CHANGE[3]:.2f}\$\s+on average", paper)
    assert score_stage.WITH_SCORE[:3] == tuple(
        values[0] for values in list(main_results.PAPER.values())[:3]
    )
    assert r"135\,s on WildTrack" in paper
    assert r"237\,s on MultiviewX" in paper
    assert r"158--230\,s" in paper
    assert list(runtime.PAPER.values())[:3] == ["135", "237", "158-230"]
    assert r"61--71\%" in paper
    assert runtime.PAPER_SHARE == (61, 71)
    for said in main_results.PAPER_OUTSIDE.values():
        assert f"{said:.2f}" in paper


def test_what_the_twins_were_set_to(paper):
    assert r"31.8\% of visible annotated boxes have no detection" in paper
    assert twins.PAPER["GMVD"]["recall"] == pytest.approx(100 - 31.8)
    assert "11{,}601 of 26{,}473" in paper
    assert twins.PAPER["GMVD c2"]["ankles"] == pytest.approx(100 * 11601 / 26473)
    for instances in ("952", "1{,}494", "4{,}083"):
        assert f"{instances} pedestrian instances" in paper
    said = [row[-1] for row in rows_of(paper, "gauge")]
    errors = [float(re.sub(r"\\,m$", "", cell)) for cell in said]
    assert errors == [twins.PAPER[name]["held_out"] for name in ("WildTrack", "MultiviewX", "GMVD")]
