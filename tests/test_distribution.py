"""Around the package: version, distributions, citation and tests."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

import catfree as cf

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def document(path):
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


def contents(builder):
    """Return the files that a distribution takes from the checkout."""
    files = builder(str(ROOT)).recurse_included_files()
    return {Path(file.distribution_path).as_posix() for file in files}


def commands(job):
    return [step["run"] for step in job["steps"] if "run" in step]


@pytest.fixture(scope="module")
def tests_workflow():
    return document(".github/workflows/tests.yml")


def test_the_version_stands_in_one_place():
    assert "version" in PROJECT["dynamic"]
    assert SdistBuilder(str(ROOT)).metadata.version == cf.__version__
    assert "version" not in document("CITATION.cff")


def test_the_changelog_begins_with_this_version_or_the_release_before():
    number = re.search(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.M)
    assert number is not None
    assert tuple(map(int, number[1].split("."))) <= tuple(
        int(part) for part in cf.__version__.split(".")[:3]
    )


def test_the_source_distribution_holds_all_that_git_does():
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a git checkout: what belongs to it is unknown")
    assert set(listed.stdout.splitlines()) - contents(SdistBuilder) == set()


def test_the_wheel_holds_the_package_alone():
    names = contents(WheelBuilder)
    page = {"catfree/viz/page/player.js", "catfree/viz/page/page.css"}
    assert {"catfree/__init__.py", "catfree/py.typed"} | page <= names
    assert all(
        re.fullmatch(r"catfree/([a-z0-9_]+/)*[a-z0-9_]+\.(py|js|css)|catfree/py\.typed", n)
        for n in names
    )


def test_the_citation_names_the_paper():
    citation = document("CITATION.cff")
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    paper = citation["preferred-citation"]
    assert paper["title"] in readme
    assert [author["family-names"] for author in paper["authors"]] == [
        "Sakai", "Kouno", "Kato", "Hotta",
    ]  # fmt: skip
    assert citation["title"] == PROJECT["name"]
    assert citation["license"] == PROJECT["license"]


def test_hosted_and_local_runs_test_as_the_readme_says(tests_workflow):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    command = re.search(
        r"^pip install -e '\.\[test\]' && (python -m pytest.*)$", readme, re.MULTILINE
    )
    assert command is not None
    install, test = command[0].split(" && ")
    assert commands(tests_workflow["jobs"]["tests"]) == [install, test]
    assert commands(tests_workflow["jobs"]["lowest-versions"])[-1] == test
    local = (ROOT / ".ci" / "run").read_text().splitlines()
    assert local[-2] == test  # the quick part of the gate comes last
    lint = commands(tests_workflow["jobs"]["lint"])[1:]
    assert [words.split()[:2] for words in lint] == [words.split()[:2] for words in local[-5:-2]]


def test_hosted_runs_cover_the_versions_that_are_declared(tests_workflow):
    stated = [
        name.rsplit(" ", 1)[1]
        for name in PROJECT["classifiers"]
        if re.fullmatch(r"Programming Language :: Python :: 3\.\d+", name)
    ]
    matrix = tests_workflow["jobs"]["tests"]["strategy"]["matrix"]
    assert matrix["python"] == stated
    assert {name.split("-")[0] for name in matrix["os"]} == {"ubuntu", "macos", "windows"}


@pytest.mark.parametrize("path", sorted((ROOT / ".github").rglob("*.yml")), ids=lambda p: p.name)
def test_actions_are_pinned_to_a_major_version(path):
    text = path.read_text(encoding="utf-8")
    assert isinstance(yaml.safe_load(text), dict)
    for action in re.findall(r"uses: (\S+)", text):
        assert re.fullmatch(r"actions/[a-z-]+@v\d+", action)


def test_hooks_run_the_tools_of_the_lint_job(tests_workflow):
    hooks = document(".pre-commit-config.yaml")["repos"][0]["hooks"]
    jobs = commands(tests_workflow["jobs"]["lint"])[1:]
    assert [hook["entry"].split()[0] for hook in hooks] == [words.split()[0] for words in jobs]
