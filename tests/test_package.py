"""The package as a whole: what importing it costs, which way imports point, what is documented."""

import ast
import importlib
import inspect
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import catfree as cf

ROOT = Path(cf.__file__).parent

# Each folder or module, and what it may import; `errors`, `types`, `settings` are free to all.
FOUNDATION = {"errors", "types", "settings"}
ALLOWED = {
    "errors": set(),
    "types": set(),
    "settings": set(),
    "geometry": set(),
    "filters": {"geometry"},
    "association": {"geometry", "filters"},
    "trajectories": {"geometry", "filters", "association"},
    "evidence": {"geometry", "filters"},
    "rig": {"geometry", "association", "evidence"},
    "coverage": {"geometry", "association"},
    "evaluation": {"geometry"},
    "adapters": set(),
    "synthetic": {"geometry"},
    "viz": {"geometry", "association", "coverage", "evaluation", "adapters"},
    "testing": {"geometry"},
    "compilation": {"filters", "association"},
    "outcome": {"filters", "association", "trajectories"},
    "expectation_fits": set(),
    "expectation": {"expectation_fits"},
    "pipeline": {"filters", "association", "trajectories", "evidence"}
    | {"compilation", "outcome", "expectation"},
    "cache": set(),
    "cached_detection": {"adapters", "cache"},
    "reconstruction": {"adapters", "rig"},
    "second_look": {"geometry", "trajectories", "adapters"},
    "stages": {"trajectories", "rig", "adapters", "cache", "cached_detection"}
    | {"reconstruction", "second_look", "pipeline"},
    "run": {"rig", "adapters", "cache", "stages"},
    "report": {"rig", "adapters", "run"},
    "output": {"trajectories", "coverage", "adapters", "viz", "cache", "run", "report"},
    "demo": {"geometry", "evidence", "evaluation", "adapters", "synthetic"}
    | {"run", "report", "output"},
    "cli_inputs": {"adapters"},
    "cli_terminal": set(),
    "cli": {"evaluation", "adapters", "viz", "cache", "stages", "run", "report", "output"}
    | {"demo", "cli_inputs", "cli_terminal"},
    "__main__": {"cli"},
}
# Names that live further up and are found here too, because callers know them from here.
EXPORTED_FROM_ABOVE = {Path("rig/__init__.py"): {"reconstruction"}}
# What only other folders of this kind may import.
TOP_ONLY = {"viz", "cli", "cli_inputs", "cli_terminal", "output", "demo"}


def modules():
    return sorted(path.relative_to(ROOT) for path in ROOT.rglob("*.py"))


def imported(path: Path) -> set[str]:
    """First component below `catfree` of everything that a module imports from the package."""
    found = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = [node.module]
            if node.module == "catfree":
                names = [f"catfree.{alias.name}" for alias in node.names]
        found |= {name.split(".")[1] for name in names if name.startswith("catfree.")}
    return found


def folder_of(path: Path) -> str:
    return path.parts[0].removesuffix(".py")


def test_every_folder_and_module_has_its_place():
    assert {folder_of(path) for path in modules()} - {"__init__"} == set(ALLOWED)


def test_the_places_have_an_order():
    assert list(TopologicalSorter(ALLOWED).static_order())  # raises where imports go in a circle


@pytest.mark.parametrize("name", sorted(ALLOWED))
def test_imports_point_one_way(name):
    for path in modules():
        if folder_of(path) == name:
            beyond = imported(path) - FOUNDATION - ALLOWED[name] - {name}
            beyond -= EXPORTED_FROM_ABOVE.get(path, set())
            assert beyond == set(), f"{path} imports {sorted(beyond)}"


def test_nothing_imports_what_stands_on_top():
    for path in modules():
        if folder_of(path) not in TOP_ONLY and path.name != "__main__.py":
            assert not imported(path) & TOP_ONLY, path


def test_imports_are_absolute():
    for path in modules():
        for node in ast.walk(ast.parse((ROOT / path).read_text())):
            assert not (isinstance(node, ast.ImportFrom) and node.level), path


def fresh(code: str) -> str:
    """What a new interpreter prints."""
    command = [sys.executable, "-W", "error", "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def test_importing_is_light_and_silent():
    heavy = ["cv2", "onnxruntime", "torch", "matplotlib", "trimesh", "pyarrow", "tyro"]
    heavy += ["rich", "scipy.stats"]
    code = (
        "import jax; before = dict(jax.config.values)\n"
        "import sys, catfree\n"
        f"print([name for name in {heavy} if name in sys.modules])\n"
        "print(before == dict(jax.config.values), jax.config.jax_enable_x64)"
    )
    assert fresh(code).splitlines() == ["[]", "True False"]


def test_the_version_is_that_of_the_distribution():
    from importlib.metadata import version

    assert cf.__version__ == version("catfree")


# Where users find what the library offers.
FOLDERS = ("adapters", "coverage", "evaluation", "evidence", "filters", "geometry", "rig")
FOLDERS += ("synthetic", "testing", "viz")
PLACES = (cf, *(importlib.import_module(f"catfree.{folder}") for folder in FOLDERS))


def public(wanted):
    """Everything public of a kind in the package and its sub-packages, by its public name."""
    return {
        f"{place.__name__}.{name}": thing
        for place in PLACES
        for name, thing in vars(place).items()
        if not name.startswith("_")
        and wanted(inspect.unwrap(thing))
        and thing.__module__.startswith("catfree")
    }


def public_functions():
    return public(inspect.isfunction)


def public_classes():
    return public(inspect.isclass)


@pytest.mark.parametrize("name", sorted(public_functions()))
def test_functions_say_what_goes_in_and_out(name):
    function = public_functions()[name]
    document = inspect.getdoc(function)
    assert document
    summary = document.splitlines()[0]
    assert summary.endswith((".", ":")), summary
    parameters = inspect.signature(function).parameters
    returns = inspect.signature(function).return_annotation
    if parameters:
        assert "Args:" in document
        for parameter in parameters:
            assert f"{parameter}:" in document.replace("`", ""), f"{parameter} is not described"
    if returns not in (None, "None", inspect.Signature.empty):
        assert "Returns:" in document or summary.startswith(("Yield", "Whether"))


@pytest.mark.parametrize("name", sorted(public_functions()))
def test_no_default_can_be_changed_by_a_caller(name):
    for parameter in inspect.signature(public_functions()[name]).parameters.values():
        assert not isinstance(parameter.default, (list, dict, set))


@pytest.mark.parametrize("name", sorted(public_classes()))
def test_classes_are_described(name):
    thing = public_classes()[name]
    assert inspect.getdoc(thing)
    fields = [field for field in vars(thing).get("__annotations__", {}) if field[0] != "_"]
    document = inspect.getdoc(thing) or ""
    for field in fields:
        assert field in document, f"{name}.{field} is not described"


def test_settings_are_frozen_and_the_papers():
    settings = cf.Settings.paper()
    with pytest.raises(AttributeError):
        settings.confidence = 0.5  # pyright: ignore[reportAttributeAccessIssue]
    assert hash(settings) == hash(cf.Settings.paper())
    paper = (
        settings.confidence,
        settings.rays.sigma_theta,
        settings.association.residual_factor,
        settings.association.appearance_threshold,
        settings.association.uniqueness_ratio,
        settings.triangulation.huber_scale,
        settings.selection.rms_factor,
        settings.selection.suppression_radius,
        settings.trajectories.link_radius,
        settings.trajectories.appearance_weight,
        settings.trajectories.minimum_length,
        settings.trajectories.extension_frames,
    )
    assert paper == (0.30, 0.0206, 2.0, 0.6, 0.3, 0.01, 2.0, 0.018, 0.04, 1.5, 2, 2)
