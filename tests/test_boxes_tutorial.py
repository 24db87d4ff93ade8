"""`docs/boxes_to_scores.md`: its files are written, and its commands and code run on them."""

import re
import shlex
from pathlib import Path

import pytest

from catfree.cli import main

PAGE = Path(__file__).parents[1] / "docs" / "boxes_to_scores.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)


def test_it_takes_three_commands_or_eight_lines():
    (commands,), (lines, _) = blocks("bash"), blocks("python")
    assert len(commands.splitlines()) <= 3
    assert len([line for line in lines.splitlines() if line]) <= 8


@pytest.mark.slow
def test_commands_and_lines_give_the_same_scores(tmp_path, monkeypatch, capsys):
    pytest.importorskip("tyro")
    monkeypatch.chdir(tmp_path)
    lines, files = blocks("python")
    exec(compile(files, str(PAGE), "exec"), {})
    exec(compile(lines, str(PAGE), "exec"), {})
    printed = capsys.readouterr().out
    (moda,), (idf1,) = (re.findall(rf"{name} ([\d.]+)", printed) for name in ("MODA", "IDF1"))
    install, *commands = blocks("bash")[0].splitlines()
    assert install.startswith("pip install")
    for command in commands:
        program, *words = shlex.split(command)
        assert program == "catfree"
        assert main(words) == 0
    table = capsys.readouterr().out
    assert re.search(rf"MODA \(0.5 m\).*{re.escape(moda)}", table)
    assert re.search(rf"IDF1 \(1 m\).*{re.escape(idf1)}", table)
