"""Every notebook runs from top to bottom and is stored with the outputs of such a run."""

import re
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).parents[2] / "examples" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
# Addresses in memory and paths on a disk, which differ in every run.
PASSING = re.compile(r"0x[0-9a-f]{6,}|/(tmp|home|root|Users)/|[A-Z]:\\")


@pytest.fixture(scope="module")
def refresh(load_example):
    return load_example("notebooks/refresh")


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def kinds(notebook):
    """Return the outputs of each code cell: text and pictures."""
    return [
        [sorted(output.get("data", {})) or output.get("name") for output in cell.outputs]
        for cell in code_cells(notebook)
    ]


def test_there_are_notebooks():
    assert len(NOTEBOOKS) >= 4


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_stored_as_a_run_leaves_it(path, refresh):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert notebook.cells[0].cell_type == "markdown"
    code = code_cells(notebook)
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert any(cell.outputs for cell in code)
    assert nbformat.writes(notebook) + "\n" == path.read_text(encoding="utf-8")
    assert refresh.normalized(notebook) == nbformat.read(path, as_version=4)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_its_outputs_are_small_and_the_same_everywhere(path):
    assert path.stat().st_size < 300_000
    for cell in code_cells(nbformat.read(path, as_version=4)):
        for output in cell.outputs:
            assert output.output_type in ("stream", "display_data", "execute_result")
            assert output.get("name") != "stderr"
            shown = output.get("text") or output.data.get("text/plain", "")
            assert not PASSING.search(shown), shown


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning:jupyter_client")
@pytest.mark.filterwarnings("ignore::DeprecationWarning:nbclient")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_and_shows_what_is_stored(path, refresh, tmp_path):
    assert kinds(refresh.execute(path, tmp_path)) == kinds(nbformat.read(path, as_version=4))
