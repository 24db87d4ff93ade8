"""Every Python block of the README runs, in order, in one namespace."""

import re
from pathlib import Path

import pytest

from catfree.evaluation import detection_metrics_in_area

README = Path(__file__).parents[1] / "README.md"


@pytest.mark.slow
def test_python_blocks_run(capsys):
    blocks = re.findall(r"^```python\n(.*?)^```", README.read_text(), re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 3
    namespace: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), namespace)
    printed = capsys.readouterr().out
    assert "positions of" in printed
    score, world, paper = (namespace[name] for name in ("score", "world", "paper"))
    rows = paper.tracks.to_rows(namespace["align"](paper.tracks.position)[:, :2])
    by_paper = detection_metrics_in_area(world.ground_truth, rows, world.area)
    assert score.metrics.moda > by_paper.metrics.moda
    detector = namespace["RedJackets"]()
    assert len(detector(namespace["np"].zeros((90, 160, 3), "uint8")).box) == 0


def test_the_readme_is_short_and_its_links_exist():
    text = README.read_text()
    assert len(text.splitlines()) <= 130
    targets = re.findall(r"\]\((?!http)([^)#]+)", text)
    assert targets
    for target in targets:
        assert (README.parent / target).exists(), target
