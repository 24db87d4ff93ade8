"""The gate: what counts as worse, what is reported, and what the baseline contains."""

import json
import sys

import pytest
from hypothesis import given, strategies as st

from benchmarks import gate
from benchmarks.figures import SUITES, Suite
from benchmarks.gate import FAILURES, Metric, Outcome, compare, read_baseline

finite = st.floats(-1e6, 1e6)
tolerances = st.floats(0, 1e3)
positive = st.floats(1e-3, 1e6)


def metric(value=1.0, direction="higher", tolerance=0.1, key="suite/figure"):
    return Metric(key, value, "%", direction, tolerance)


# What counts as worse.


@given(finite, tolerances, positive)
def test_better_never_fails_and_worse_by_more_than_the_tolerance_does(value, tolerance, excess):
    low, high = value - tolerance - excess, value + tolerance + excess
    for direction, better, worse in (("higher", high, low), ("lower", low, high)):
        judged = metric(value, direction, tolerance)
        assert judged.judge(better) == "better"
        assert judged.judge(worse) == "worse"
    for moved in (low, high):
        assert metric(value, "either", tolerance).judge(moved) == "worse"


@given(finite, tolerances, st.floats(-1, 1), st.sampled_from(["higher", "lower", "either"]))
def test_a_move_within_the_tolerance_is_none(value, tolerance, share, direction):
    assert metric(value, direction, tolerance).judge(value + share * tolerance) == "same"


@pytest.mark.parametrize("direction", ["higher", "lower", "either"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_what_is_no_number_is_worse_than_any(direction, value):
    assert metric(direction=direction).judge(value) == "worse"


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"value": float("nan")}, "must be finite"),
        ({"direction": "up"}, "must be one of higher, lower, either"),
        ({"tolerance": -0.1}, "must be finite and not negative"),
        ({"tolerance": float("nan")}, "must be finite and not negative"),
    ],
)
def test_impossible_entries_are_refused_by_name(fields, said):
    with pytest.raises(ValueError, match=said) as caught:
        metric(**fields)
    assert "suite/figure" in str(caught.value)


# What is reported.


def test_a_figure_without_baseline_and_one_that_is_gone_are_both_named():
    baseline = {key: metric(key=key) for key in ("suite/kept", "suite/gone", "suite two/other")}
    lines = compare("suite", Outcome({"kept": 1.0, "new": 2.0}), baseline)
    verdicts = {line.key: line.verdict for line in lines}
    assert verdicts == {
        "suite/kept": "same",
        "suite/new": "no baseline",
        "suite/gone": "not measured",
    }
    assert {"no baseline", "not measured"} <= set(FAILURES)


@pytest.mark.parametrize("known", [False, True])
def test_a_suite_that_breaks_fails_with_its_reason(known):
    def breaks(data):
        raise RuntimeError("the solver gave up")

    baseline = {"suite/figure": metric()} if known else {}
    outcome = gate.measure(Suite("suite", breaks), None)
    (line,) = compare("suite", outcome, baseline)
    assert line.verdict in FAILURES
    assert "RuntimeError: the solver gave up" in str(line)


def test_absent_data_are_named_and_do_not_fail(tmp_path):
    suite = Suite("suite", lambda data: {"figure": 1.0}, needs="real/somewhere.json")
    for data in (None, tmp_path):
        (line,) = compare("suite", gate.measure(suite, data), {"suite/figure": metric()})
        assert line.verdict == "absent"
        assert "real/somewhere.json" in str(line)
    assert "absent" not in FAILURES


def test_an_entry_of_no_suite_is_named():
    (line,) = gate.orphans(["suite/figure", "former/figure"], ["suite"])
    assert line.key == "former/figure"
    assert line.verdict in FAILURES


# The command.


@pytest.fixture
def command(monkeypatch, tmp_path, capsys):
    """Run the gate on one suite with its own baseline; return exit code and output."""

    def run(measured, *arguments, value=50.0):
        entry = {"value": value, "unit": "%", "direction": "higher", "tolerance": 0.1}
        baseline = tmp_path / "baseline.json"
        baseline.write_text(json.dumps({"one/figure": entry}))
        suites = [
            Suite("one", lambda data: {"figure": measured}, quick=True),
            Suite("slow", lambda data: pytest.fail("not asked for")),
        ]
        monkeypatch.setattr(gate, "SUITES", suites)
        monkeypatch.setattr(gate, "BASELINE", baseline)
        monkeypatch.setattr(sys, "argv", ["gate", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            gate.main()
        said = capsys.readouterr()
        return int(left.value.code), said.out + said.err

    return run


def test_the_command_fails_if_and_only_if_something_got_worse(command, tmp_path):
    file = tmp_path / "measured.json"
    for measured, code in ((49.0, 1), (49.95, 0), (50.0, 0), (60.0, 0)):
        left, said = command(measured, "--quick", "--measured", file)
        assert left == code
        assert ("Worse than the baseline" in said) == bool(code)
        assert json.loads(file.read_text())["figures"] == {"one/figure": measured}


def test_the_baseline_is_never_written(command, tmp_path):
    left, said = command(60.0, "--quick", "--measured", tmp_path / "baseline.json")
    assert left == 2
    assert "changed by hand" in said
    command(60.0, "--quick")
    assert json.loads((tmp_path / "baseline.json").read_text())["one/figure"]["value"] == 50.0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--only", "nothing"], "No suite's name contains or matches 'nothing'"),
        (["--only", "slow", "--quick"], "--quick leaves out all that 'slow' chooses"),
        (["nowhere"], "neither a folder real/ nor scenarios/"),
        (["--quick", "--measured", "nowhere/file.json"], "There is no folder nowhere"),
    ],
)
def test_what_makes_no_sense_is_refused_with_a_sentence(command, arguments, said):
    left, told = command(50.0, *arguments)
    assert left == 2
    assert said in told


# The baseline and the README.


def test_names_of_suites_tell_keys_apart():
    names = [suite.name for suite in SUITES]
    assert len(set(names)) == len(names)
    assert not any(a != b and b.startswith(f"{a}/") for a in names for b in names)


def test_the_baseline_is_well_formed_and_belongs_to_the_suites():
    baseline = read_baseline(gate.BASELINE)
    assert gate.orphans(baseline, [suite.name for suite in SUITES]) == []
    with_figures = {key.rsplit("/", 1)[0] for key in baseline}
    assert with_figures == {suite.name for suite in SUITES}


def readme_keys():
    scores = ("paper MODA", "evidence MODA", "evidence IDF1", "evidence HOTA")
    rooms = ("cmc1", "cmc1 FairMOT", "cmc3", "cmc3 FairMOT")
    scenes = [f"public_{name}" for name in ("gmvd8", "mvx6", "ring5", "uneven7")]
    multiviewx = ("multiviewx_demo10_yolo26x", "multiviewx_demo10_yolo26x OSNet")
    bare = [f"{name} (no embeddings)" for name in scenes]
    for name in (*rooms, *multiviewx, *scenes, *bare):
        yield from (f"given rig/{name}/{figure}" for figure in scores)
    yield from (f"given rig/{name}/paper MODA in the tracked area" for name in rooms)
    yield from (f"given rig/wildtrack_0_715/{figure}" for figure in scores[:2])
    found = ("cameras", "centre error, mean", "centre error, worst", "scale", "stated deviation")
    found += ("MODA, similarity", "MODA, rigid")
    people = ("wildtrack_0_715", "cmc1", "cmc3", "cmc3 FairMOT", *scenes)
    for name in people:
        yield from (f"from people/{name}/{figure}" for figure in found)


def test_every_figure_of_the_readmes_tables_is_in_the_baseline():
    assert set(readme_keys()) - set(read_baseline(gate.BASELINE)) == set()
