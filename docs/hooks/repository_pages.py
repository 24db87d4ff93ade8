"""Show files from outside this folder: the changelog, the guide to contributing, the examples."""

import ast
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page
from nbconvert import MarkdownExporter

ROOT = Path(__file__).parents[2]
_PAGES = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
_LANGUAGES = {".py": "python", ".sh": "bash"}
_EXAMPLE_LINK = re.compile(r"\]\(\.\./(examples/\w+)\.\w+\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages before the navigation is built."""
    for source, page in _PAGES.items():
        text = (ROOT / source).read_text("utf-8")
        files.append(File.generated(config, page, content=text))
    notebooks = _add_notebooks(files, config)
    examples = [path for path in (ROOT / "examples").iterdir() if path.suffix in _LANGUAGES]
    rows = []
    for path in sorted(examples):
        code = path.read_text("utf-8")
        block = f"```{_LANGUAGES[path.suffix]}\n{code}```\n"
        files.append(_page_of(path, f"# {path.name}\n\n{block}", config))
        rows.append(_row_of(path, _summary(path, code)))
    text = "# Examples\n\nPrograms and notebooks of the folder `examples/`, which tests run.\n\n"
    listing = "\n".join(["| program | |", "|---|---|", *rows, *notebooks])
    files.append(File.generated(config, "examples/index.md", content=f"{text}{listing}\n"))
    return files


def _add_notebooks(files: Files, config: MkDocsConfig) -> list[str]:
    """Add a page for each notebook, with its stored outputs, and list them."""
    rows, exporter = [], MarkdownExporter()
    for path in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb")):
        text, made = exporter.from_filename(str(path), resources={"unique_key": path.stem})
        files.append(_page_of(path, text, config))
        for name, content in made["outputs"].items():
            files.append(File.generated(config, f"examples/{name}", content=content))
        rows.append(_row_of(path, text.removeprefix("# ").split("\n", 1)[0]))
    return rows


def _page_of(path: Path, text: str, config: MkDocsConfig) -> File:
    """The page of an example, which the list of examples links to."""
    return File.generated(
        config, f"examples/{path.stem}.md", content=text, inclusion=InclusionLevel.NOT_IN_NAV
    )


def _row_of(path: Path, summary: str) -> str:
    return f"| [{path.name}]({path.stem}.md) | {summary} |"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links at the pages of examples instead of at their files."""
    return _EXAMPLE_LINK.sub(r"](\1.md)", markdown)


def _summary(path: Path, code: str) -> str:
    if path.suffix == ".py":
        document = ast.get_docstring(ast.parse(code)) or ""
    else:
        document = next(
            (line.lstrip("# ") for line in code.splitlines() if line.startswith("# ")), ""
        )
    return document.split("\n\n")[0].replace("\n", " ")
