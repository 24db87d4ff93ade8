"""Output of the command line: readable names of all stages, failures on standard error."""

import ast
import contextlib
from pathlib import Path

import pytest

import catfree
from catfree.cli import _terminal as cli_terminal
from catfree.cli._terminal import FAILURE, STAGE_LABELS, fail, print_table, print_text, warn
from catfree.errors import WriteError
from catfree.viz.page._blocks import Table

ROOT = Path(catfree.__file__).parent
CALLBACKS = {"report", "progress"}


def reported_stages() -> dict[str, set[str]]:
    """Find the stages that modules report through a progress callback, and these modules."""
    found: dict[str, set[str]] = {}
    for path in sorted(ROOT.rglob("*.py")):
        tree = ast.parse(path.read_text())
        constants = {
            target.id: node.value
            for node in tree.body
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            name = getattr(node.func, "id", getattr(node.func, "attr", None))
            given = [word.value for word in node.keywords if word.arg == "stage"]
            stage = given[0] if given else node.args[0] if name in CALLBACKS and node.args else None
            if stage is None or (isinstance(stage, ast.Name) and stage.id == "stage"):
                continue  # callers of such a function pass the stage, by `stage=`
            if isinstance(stage, ast.Name):
                stage = constants.get(stage.id)
            where = str(path.relative_to(ROOT))
            assert isinstance(stage, ast.Constant), f"{where}:{node.lineno} hides its stage"
            assert isinstance(stage.value, str)
            found.setdefault(stage.value, set()).add(where)
    return found


@pytest.mark.slow
def test_every_reported_stage_has_a_label_and_every_label_a_stage():
    reported = reported_stages()
    unnamed = {stage: where for stage, where in reported.items() if stage not in STAGE_LABELS}
    assert unnamed == {}
    assert set(STAGE_LABELS) - set(reported) == set()


def test_labels_fit_their_column_and_differ():
    assert max(map(len, STAGE_LABELS.values())) <= 30
    assert len(set(STAGE_LABELS.values())) == len(STAGE_LABELS)


def test_bars_show_the_label_of_a_stage(capsys):
    pytest.importorskip("rich")
    with cli_terminal.progress_bars() as progress:
        progress("second look", 1, 2)
        progress("association", 2, 2)
    shown = capsys.readouterr().err
    assert STAGE_LABELS["second look"] in shown
    assert "2/2" in shown


def test_stages_that_begin_again_finish_those_before_them(capsys):
    pytest.importorskip("rich")
    with cli_terminal.progress_bars() as progress:
        for stage in ("self-calibration", "association") * 2:
            progress(stage, 0, 1)
    shown = capsys.readouterr().err
    assert "0/1" not in shown.splitlines()[-1]
    assert shown.count("1/1") == 2


def test_advice_names_the_options_of_the_command_line(capsys):
    fail("It is damaged. Repair it, or pass on_error='keep' to use what\ncame before it.")
    error = capsys.readouterr().err
    assert error.endswith("Repair it, or give --keep-before-damage to use what came before it.\n")


@pytest.mark.parametrize(
    ("library", "command"),
    [
        ("1 of 4 shards are not finished (2). Run them with cf.run_shard.", "with catfree shard."),
        ("It changed. Make the plan again with cf.shards.", "again with catfree plan."),
    ],
)
def test_advice_names_commands(capsys, library, command):
    fail(library)
    assert capsys.readouterr().err.endswith(f"{command}\n")


def test_warnings_are_lines_with_the_words_of_the_shell(capsys):
    warn(("If so, pass offsets=(0, -10, 0).", "Too\nlow. Pass a detector of people."))
    assert capsys.readouterr().err.splitlines() == [
        "catfree: warning: If so, give --offsets 0 -10 0.",
        "catfree: warning: Too low. Give --detector, a detector of people.",
    ]


def test_paths_that_are_no_text_are_escaped(capsys):
    print_text("pictures in gr\udcf6\udcdfe")
    assert capsys.readouterr().out == "pictures in gr\\udcf6\\udcdfe\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is of Linux")
@pytest.mark.parametrize("show", [print_text, lambda text: print_table(Table((text,), ()))])
def test_a_full_standard_output_is_named(monkeypatch, show):
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr("sys.stdout", full)
        with pytest.raises(WriteError, match=r"^Standard output: No space left on device\.$"):
            show("text")
        monkeypatch.undo()
        with contextlib.suppress(OSError):
            full.close()


def test_tables_are_printed_whole(capsys):
    pytest.importorskip("rich")
    print_table(Table(("measure", "value"), (("MODA", "97.10"),)))
    shown = capsys.readouterr().out
    for word in ("measure", "value", "MODA", "97.10"):
        assert word in shown


def test_names_of_cameras_fold_where_the_terminal_is_narrow(capsys, monkeypatch):
    pytest.importorskip("rich")
    monkeypatch.setenv("COLUMNS", "80")
    name = "entrance_hall_north_side_above_the_door"
    header = ("camera", "verdict", "since frame", "turned (degrees)", "pixels", "late (frames)")
    print_table(Table(header, ((name, "moved", "12345 +- 3", "10.00 +- 0.12", "123", "0.01"),)))
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "\N{HORIZONTAL ELLIPSIS}" not in shown
    cells = [line.split("\N{BOX DRAWINGS LIGHT VERTICAL}") for line in shown.splitlines()]
    rows = [row for row in cells if len(row) > 1]
    assert "".join(row[1].strip() for row in rows) == name


@pytest.mark.parametrize("columns", [80, 60])
def test_verdicts_do_not_fold(capsys, monkeypatch, columns):
    pytest.importorskip("rich")
    monkeypatch.setenv("COLUMNS", str(columns))
    header = ("camera", "verdict", "since frame", "turned (degrees)", "pixels", "ground (m)")
    row = ("C1", "doubtful", "12345 +- 3", "10.00 +- 0.12", "123", "0.01", "-0.10 +- 0.12", "75")
    print_table(Table((*header, "late (frames)", "people matched (%)"), (row,)))
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= columns
    for word in ("verdict", "doubtful", "pixels"):
        assert word in shown


def test_tables_in_a_file_are_not_folded(capsys, monkeypatch):
    pytest.importorskip("rich")
    monkeypatch.delenv("COLUMNS", raising=False)
    row = ("north", *["doubtful 12.00 +- 0.34"] * 7)
    print_table(Table(("camera", *["people matched (%)"] * 7), (row,)))
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 5
    assert shown[3].count("doubtful 12.00 +- 0.34") == 7


@pytest.mark.parametrize("name", ["hall [north]", "x[/b]", "gate :smile:"])
def test_names_of_cameras_are_no_markup(capsys, name):
    pytest.importorskip("rich")
    print_table(Table(("camera",), ((name,),)))
    assert name in capsys.readouterr().out


def test_failures_are_one_line_with_the_name_of_the_program(capsys):
    assert fail("No video.") == FAILURE
    assert capsys.readouterr().err == "catfree: No video.\n"
