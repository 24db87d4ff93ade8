import sys
from pathlib import Path

import cv2
import pytest

pytestmark = pytest.mark.slow

STORED = Path(__file__).parents[2] / "docs" / "gallery"


def test_it_draws_the_pictures_of_the_documentation(load_example, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setattr(sys, "argv", ["gallery.py", "--out", str(tmp_path)])
    load_example("gallery").main()
    stored = sorted(path.name for path in STORED.iterdir())
    assert capsys.readouterr().out.split() == stored
    for name in stored:
        drawn, kept = cv2.imread(str(tmp_path / name)), cv2.imread(str(STORED / name))
        assert drawn.shape[1] == kept.shape[1]
        assert drawn.std() > 10
        assert (STORED / name).stat().st_size < 150_000
