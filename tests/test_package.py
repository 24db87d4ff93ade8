"""The package as a whole: cost of importing, direction of imports, documentation."""

import ast
import importlib
import inspect
import pkgutil
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import catfree as cf
from catfree._worker import (
    LAST_WITH_OPTION,
    QUICK_COMPILATION,
    jaxlib_version,
)

ROOT = Path(cf.__file__).parent

# Each package, from the bottom up, and the packages that it may import; `errors`, `types`,
# `settings` and `_worker` may be imported by all.
FOUNDATION = {"errors", "types", "settings", "_worker"}
ALLOWED = {
    "errors": set(),
    "_worker": set(),
    "types": set(),
    "settings": set(),
    "geometry": set(),
    "filters": {"geometry"},
    "adapters": set(),
    "synthetic": {"geometry"},
    "testing": {"geometry"},
    "evaluation": {"geometry"},
    "_coverage": {"geometry"},
    "methods": {"geometry", "filters"},
    "calibration": {"geometry", "methods", "adapters"},
    "viz": {"geometry", "_coverage", "evaluation", "adapters"},
    "_run": {"geometry", "adapters", "methods", "calibration", "_coverage", "viz"},
    "_public": {"geometry", "adapters", "methods", "calibration", "_coverage", "_run"},
    "cli": {
        "geometry",
        "adapters",
        "synthetic",
        "evaluation",
        "methods",
        "calibration",
        "viz",
        "_run",
    },
    "__main__": {"cli"},
}
MOST_ENTRIES = 12  # in one folder, `__init__.py` aside


def source_files() -> list[Path]:
    return sorted(path.relative_to(ROOT) for path in ROOT.rglob("*.py"))


def imported(path: Path) -> set[tuple[str, ...]]:
    """Return the paths below `catfree` of all that a module imports from the package."""
    names = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            for alias in node.names:
                inside = ROOT.parent.joinpath(*node.module.split("."), alias.name)
                is_module = inside.with_suffix(".py").exists() or inside.is_dir()
                names.add(f"{node.module}.{alias.name}" if is_module else node.module)
    return {tuple(name.split(".")[1:]) for name in names if name.startswith("catfree.")}


def place_of(path: Path) -> tuple[str, ...]:
    return path.with_suffix("").parts


def test_every_room_has_its_place():
    rooms = {place_of(path)[0] for path in source_files()} - {"__init__"}
    assert rooms == set(ALLOWED)


@pytest.mark.slow
@pytest.mark.parametrize("room", sorted(ALLOWED))
def test_imports_point_one_way(room):
    for path in source_files():
        if place_of(path)[0] == room:
            beyond = {target[0] for target in imported(path)} - FOUNDATION - ALLOWED[room] - {room}
            assert beyond == set(), f"{path} imports {sorted(beyond)}"


@pytest.mark.slow
@pytest.mark.parametrize(
    "folder", sorted(str(path.parent) for path in source_files() if path.name == "__init__.py")
)
def test_the_entries_of_a_folder_have_an_order(folder):
    above = () if folder == "." else Path(folder).parts
    needs: dict[str, set[str]] = {}
    for path in source_files():
        place = place_of(path)
        if place[: len(above)] == above and place[len(above)] != "__init__":
            own = place[len(above)]
            beside = {
                target[len(above)]
                for target in imported(path)
                if target[: len(above)] == above and len(target) > len(above)
            }
            needs[own] = needs.get(own, set()) | beside - {own}
    assert list(TopologicalSorter(needs).static_order())  # raises for circular imports


@pytest.mark.slow
def test_folders_are_short_and_modules_are_private_or_meant_to_be_imported():
    public_modules = {"errors.py", "testing.py", "__main__.py", "adapters/protocols.py"}
    for folder in {path.parent for path in source_files()}:
        entries = {
            path.relative_to(folder).parts[0]
            for path in source_files()
            if path.is_relative_to(folder)
        }
        if folder != Path("."):
            assert len(entries - {"__init__.py"}) <= MOST_ENTRIES, folder
    for path in source_files():
        private = path.name.startswith("_")
        assert private or str(path) in public_modules, path


def test_module_names_are_unique():
    names = [path.name for path in source_files() if path.name != "__init__.py"]
    assert sorted(names) == sorted(set(names))


def test_no_public_name_is_shadowed_by_a_module():
    for path in source_files():
        if path.name == "__init__.py":
            package = importlib.import_module(".".join(["catfree", *path.parent.parts]))
            for module in pkgutil.iter_modules(package.__path__):
                found = vars(package).get(module.name)
                assert found is None or inspect.ismodule(found), f"{path.parent}/{module.name}"


@pytest.mark.slow
def test_the_package_lists_its_curated_names_only():
    modules = {"adapters", "calibration", "errors", "evaluation", "filters", "geometry", "methods"}
    modules |= {"settings", "synthetic", "testing", "types", "viz"}
    code = "import catfree as cf, inspect; names = dir(cf); print(*names); "
    listed, found = fresh(
        code + "print(*(name for name in names if inspect.ismodule(getattr(cf, name))))"
    ).splitlines()
    assert set(found.split()) == modules
    assert not any(name.startswith("_") for name in listed.split())


@pytest.mark.slow
def test_imports_are_absolute():
    for path in source_files():
        for node in ast.walk(ast.parse((ROOT / path).read_text())):
            assert not (isinstance(node, ast.ImportFrom) and node.level), path


def fresh(code: str) -> str:
    """Return the output of a new interpreter."""
    command = [sys.executable, "-W", "error", "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.mark.slow
def test_importing_is_light_and_silent():
    heavy = ["cv2", "onnxruntime", "torch", "matplotlib", "trimesh", "pyarrow", "tyro"]
    heavy += ["rich", "scipy.stats"]
    code = (
        "import jax; before = dict(jax.config.values)\n"
        "import sys, catfree\n"
        "catfree.localize\n"
        f"print([name for name in {heavy} if name in sys.modules])\n"
        "print(before == dict(jax.config.values), jax.config.jax_enable_x64)"
    )
    assert fresh(code).splitlines() == ["[]", "True False"]


@pytest.mark.slow
def test_boxes_are_localized_where_opencv_and_onnxruntime_are_missing():
    code = (
        "import sys; sys.modules |= dict.fromkeys(('cv2', 'onnxruntime'))\n"
        "import catfree as cf\n"
        "world = cf.synthetic.make_world('ring4', 0, frames=4, people=3)\n"
        "print(len(cf.localize(world.detections, world.true_scene).tracks) > 0)"
    )
    assert fresh(code) == "True"


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["run", "--help"]])
def test_help_does_not_wait_for_numerical_libraries(arguments):
    pytest.importorskip("tyro")
    code = (
        "import sys, contextlib\n"
        "from catfree.__main__ import main\n"
        f"sys.argv = ['catfree', *{arguments}]\n"
        "with contextlib.suppress(SystemExit): main()\n"
        "print(sorted({'jax', 'equinox', 'scipy', 'cv2'} & set(sys.modules)))"
    )
    assert fresh(code).splitlines()[-1] == "[]"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "given", "flags"),
    [
        ("localize", None, QUICK_COMPILATION),
        ("localize", "--xla_cpu_use_fusion_emitters=true", "--xla_cpu_use_fusion_emitters=true"),
        ("shard", None, QUICK_COMPILATION),
    ],
)
def test_a_command_compiles_quickly_unless_told_otherwise(command, given, flags):
    environment = {} if given is None else {"XLA_FLAGS": given}
    code = (
        "import os, sys, contextlib\n"
        "os.environ.pop('XLA_FLAGS', None)\n"
        f"os.environ |= {environment}\n"
        "from catfree.__main__ import main\n"
        f"sys.argv = ['catfree', {command!r}, '--help']\n"
        "with contextlib.suppress(SystemExit): main()\n"
        "import jax\n"  # ends the process if the option is unknown
        "print(float(jax.jit(lambda x: x + 1)(1.0)), os.environ.get('XLA_FLAGS'))"
    )
    expected = flags if jaxlib_version() <= LAST_WITH_OPTION else given
    assert fresh(code).splitlines()[-1] == f"2.0 {expected}"


@pytest.mark.slow
@pytest.mark.parametrize(("given", "threads"), [(None, "1"), ("2", "2")])
def test_a_command_multiplies_matrices_in_one_thread_unless_told_otherwise(given, threads):
    environment = {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    code = (
        "import os, sys, contextlib\n"
        "os.environ.pop('OPENBLAS_NUM_THREADS', None)\n"
        f"os.environ |= {environment}\n"
        "from catfree.__main__ import main\n"
        "sys.argv = ['catfree', 'calibrate', '--help']\n"
        "with contextlib.suppress(SystemExit): main()\n"
        "print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    assert fresh(code).splitlines()[-1] == threads


@pytest.mark.slow
def test_every_listed_name_can_be_imported_and_no_other():
    code = (
        "from catfree import *\n"
        "names = {name for name in dir() if name[0] != '_'}\n"
        "import catfree\n"
        "print(names == set(dir(catfree)), all(hasattr(catfree, name) for name in names))"
    )
    assert fresh(code) == "True True"
    with pytest.raises(AttributeError, match="no attribute 'locate'"):
        getattr(cf, "locate")  # noqa: B009


# Where users find the library's functions.
FOLDERS = ("adapters", "calibration", "evaluation", "filters", "geometry", "methods")
FOLDERS += ("methods.evidence", "synthetic", "testing", "viz")
PLACES = (cf, *(importlib.import_module(f"catfree.{folder}") for folder in FOLDERS))


def public(wanted):
    """Find everything public of a kind in the package and sub-packages, by public name."""
    return {
        f"{place.__name__}.{name}": thing
        for place in PLACES
        for name in (dir(cf) if place is cf else vars(place))
        if not name.startswith("_")
        and wanted(inspect.unwrap(thing := getattr(place, name)))
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
