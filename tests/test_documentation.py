"""The documentation: code runs and prints the stated output, site builds, tables are right."""

import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import catfree as cf
from catfree.cli import main

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


def load(name):
    """Load a module of the hooks' folder, which is not a package."""
    specification = importlib.util.spec_from_file_location(name, DOCS / "hooks" / f"{name}.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


run_pages, error_sentences = load("run_pages"), load("error_sentences")


def test_most_pages_that_teach_have_code():
    names = {path.stem for path in run_pages.pages()}
    assert {"first_tracks", "calibrate", "acceptance", "your_detector", "evaluate"} <= names


@pytest.mark.slow
def test_the_code_of_all_pages_runs_and_prints_what_they_say():
    # In a separate process, where array shape checks do not slow down a calibration.
    script = str(DOCS / "hooks" / "run_pages.py")
    command = [sys.executable, "-W", "error::RuntimeWarning", script, "--check"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    advice = "If that is right, run `python docs/hooks/run_pages.py`."
    assert ran.returncode == 0, f"{ran.stdout}\n{advice}\n{ran.stderr}"


def test_outputs_are_stored_where_they_belong(tmp_path):
    page = tmp_path / "page.md"
    blocks = (
        "```python\nprint(number)\n```\n",
        "<!-- not run: it would fail -->\n```python\n1 / 0\n```\n",
        "<!-- run first -->\n```python\nnumber = 42\nprint('set')\n```\n",
        "<!-- prepare\nassert number == 42\n-->\n",
    )
    page.write_text("\n".join(blocks))
    assert len(run_pages.check(page)) == 2
    run_pages.store(page)
    assert run_pages.check(page) == []
    text = page.read_text()
    assert "print(number)\n```\n\n```text\n42\n```\n" in text
    assert "<!-- run first -->\n```python" in text
    assert "```text\nset\n```" in text
    page.write_text(text.replace("\n42\n", "\n60\n"))
    assert len(run_pages.check(page)) == 1


@pytest.mark.parametrize(
    ("stated", "printed", "same"),
    [
        ("MODA 95\n", "MODA 96.5\n", True),
        ("MODA 95\n", "MODA 70\n", False),
        ("MODA 95\n", "MODP 95\n", False),
        ("", "MODA 95\n", False),
        ("[0 0 0]", "[0 0]", False),
        ("5 of 5 cameras", "5  of 5\ncameras", True),
    ],
)
def test_outputs_agree_but_for_digits(stated, printed, same):
    assert run_pages.agree(stated, printed) == same


def stated_commands():
    """Yield each call of `catfree` in the pages, as shell words."""
    for path in (ROOT / "README.md", *sorted(DOCS.glob("*.md"))):
        blocks = re.findall(
            r"^```bash\n(.*?)^```", path.read_text("utf-8"), re.DOTALL | re.MULTILINE
        )
        for line in "".join(blocks).replace("\\\n", " ").splitlines():
            for call in line.split("&&"):
                words = shlex.split(call, comments=True)
                if words[:1] == ["catfree"]:
                    yield path.name, words[1:]


@pytest.mark.slow
def test_stated_commands_and_their_options_exist(capsys):
    pytest.importorskip("tyro")
    commands = {(*words[:1],) if words[0] != "weights" else (*words[:2],)
                for _, words in stated_commands()}  # fmt: skip
    assert {("run",), ("demo",), ("evaluate",), ("run-sites",), ("weights", "get")} <= commands
    accepted = {}
    for command in commands:
        with pytest.raises(SystemExit) as ended:
            main([*command, "--help"])
        assert ended.value.code == 0, command
        accepted[command] = set(re.findall(r"--[a-z][a-z-]*", capsys.readouterr().out))
    for page, words in stated_commands():
        options = {word for word in words if word.startswith("--")}
        known = accepted.get((words[0],)) or accepted[(words[0], words[1])]
        assert options <= known, f"{page}: catfree {' '.join(words)}"


def explained():
    """Return the quotes in the first column of the error page's tables."""
    text = (DOCS / "what_goes_wrong.md").read_text("utf-8")
    return re.findall(r"^\| `([^`]+)` \|", text, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("sentence", explained())
def test_explained_sentences_are_those_of_the_code(sentence):
    assert sentence in error_sentences.texts()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["CalibrationError", "GroundRejectedError"])
def test_every_failure_of_a_calibration_is_explained(kind):
    for sentence in error_sentences.sentences()[kind]:
        assert any(part in sentence for part in explained()), (
            f"docs/what_goes_wrong.md should give cause and remedy of {sentence!r}."
        )


@pytest.mark.slow
def test_the_listing_has_every_class_and_escapes_what_it_shows():
    listing = error_sentences.on_page_markdown(f"above\n{error_sentences.MARK}\nbelow")
    assert listing.startswith("above\n### CatFreeError")
    for name, found in error_sentences.sentences().items():
        assert f"### {name}\n" in listing
        assert len(found) == len(set(found))
    assert not re.search(r"<(?!/?(details|summary|ul|li)>)", listing)
    assert len(error_sentences.sentences()["InvalidInputError"]) > 200
    assert any("pandas" in text for text in error_sentences.sentences()["MissingDependencyError"])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site with warnings as errors."""
    for name in ("mkdocs", "material", "mkdocstrings_handlers.python", "nbconvert"):
        pytest.importorskip(name, reason="pip install 'catfree[docs]'")
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return out


@pytest.mark.slow
def test_notebooks_are_pages_with_their_outputs(site):
    listed = (site / "examples" / "index.html").read_text("utf-8")
    notebooks = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
    for path in notebooks:
        assert f'href="{path.stem}.html"' in listed
        page = (site / "examples" / f"{path.stem}.html").read_text("utf-8")
        pictures = re.findall(r'<img[^>]* src="([^"]*)"', page)
        stored = path.read_text("utf-8")
        assert len(pictures) == len(re.findall(r'"image/(?:png|jpeg)": "', stored))
        assert all((site / "examples" / picture).stat().st_size > 1000 for picture in pictures)
    assert notebooks


@pytest.mark.slow
def test_the_site_builds_and_every_public_name_has_an_entry(site):
    offered = load("api_pages").offered()
    pages = {place: site / "api" / f"{place.removeprefix('catfree.')}.html" for place in offered}
    packages = {place.split(".")[1] for place in offered if place != "catfree"}
    assert set(dir(cf)) - {"jaxtyping"} == {*offered["catfree"], *packages}
    for place, names in offered.items():
        page = pages[place].read_text("utf-8")
        for name in names:
            assert f'id="{place}.{name}"' in page, f"{place}.{name} has no entry"
    commands = (site / "command_line.html").read_text("utf-8")
    for option in ("--max-offset", "--area", "weights get"):
        assert option in commands
    assert "\x1b" not in commands


@pytest.mark.slow
def test_pages_ask_no_other_server_for_anything(site):
    for page in site.rglob("*.html"):
        text = page.read_text("utf-8")
        loaded = re.findall(r"<(?:script|img|link|iframe)\b[^>]*?(?:src|href)=\"?(\S+)", text)
        foreign = [address for address in loaded if address.startswith(("http:", "https:", "//"))]
        assert foreign == [], page
