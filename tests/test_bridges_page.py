"""Every Python block of `docs/bridges.md` runs, in order, in one namespace."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "bridges.md"


@pytest.mark.slow
def test_python_blocks_run(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    pytest.importorskip("supervision", reason="Supervision is not installed")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    namespace: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), namespace)
    assert namespace["reference"].residual.max() < 1
    written = {path.name for path in tmp_path.iterdir()}
    assert written >= {"tracks.txt", "camInfo", "track1.txt", "trackeval", "tracks.geojson"}
