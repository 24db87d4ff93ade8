"""Strict JAX for every test: no silent promotion, shapes checked, both float widths available."""

import functools
import gc
import inspect
import itertools
import os
import re
from collections import Counter
from pathlib import Path
from typing import Any

import jax
import jaxtyping
import pytest
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

# Checking every call of a loop that runs thousands of times takes a third of a test's time. Each
# test checks this many first calls of a function; tests that Hypothesis repeats check this many
# times the usual number of examples.
CHECKS = 4
_calls: Counter[str] = Counter()
_most = CHECKS
_jaxtyped = jaxtyping.jaxtyped


def check_first_calls(function: Any = None, **checker: Any) -> Any:
    """Let jaxtyping check only the first calls of each function per test; classes as usual."""
    if function is None:
        return functools.partial(check_first_calls, **checker)
    if not inspect.isfunction(function):
        return _jaxtyped(function, **checker)
    name = f"{function.__module__}.{function.__qualname__}"
    if _calls[name] >= _most:  # of a function within another one
        return function
    checked = None

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked
        if _calls[name] >= _most:
            return function(*args, **kwargs)
        _calls[name] += 1
        if checked is None:  # generating all functions' checks takes half of the import time
            checked = _jaxtyped(function, **checker)
        return checked(*args, **kwargs)

    return call


# The hook decorates with this attribute; its own decorator also binds the arguments of unchecked
# calls.
jaxtyping.jaxtyped = check_first_calls
install_import_hook("catfree", "beartype.beartype")

# Tests compile thousands of small functions, in half the time with these flags and with equally
# exact results. (Optimization level 0 is even faster, but jaxlib 0.10.2 then computes wrong
# Hessians.)
COMPILE_FAST = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
os.environ.setdefault("XLA_FLAGS", COMPILE_FAST)  # JAX reads it at the first array

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

settings.register_profile(
    "catfree",
    deadline=None,  # the first example compiles
    derandomize=True,
    max_examples=25,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("catfree")


def pytest_configure(config: pytest.Config) -> None:
    """Share JAX's compiled code with other workers, tested commands and the next run.

    Files go to the workers in order, so that long tests are not left to the end.
    """
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False
    if not config.pluginmanager.hasplugin("cacheprovider"):
        return
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(config.cache.mkdir("compiled")))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.02")
    jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
    seconds = float(os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", seconds)


SLOW_FILE = re.compile(r"^pytestmark = .*pytest\.mark\.slow\b", re.MULTILINE)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Skip files with only slow tests unless they are named, because importing takes time."""
    if config.option.markexpr != "not slow" or collection_path.suffix != ".py":
        return None
    if collection_path in {Path(name.split("::")[0]).absolute() for name in config.args}:
        return None
    return SLOW_FILE.search(collection_path.read_text(encoding="utf-8")) is not None or None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of whole documents first: the last files of a run should be short ones."""
    items.sort(key=lambda item: item.path.parent != Path(__file__).parent)


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Let tests of a file share a worker and its compiled code by default."""
    if getattr(config.option, "numprocesses", None) and config.option.dist == "no":
        config.option.dist = "loadfile"


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Use one worker more than processors: slow tests wait for processes, files and brokers.

    Quick tests do not wait, and each worker imports all files.
    """
    quick = config.option.markexpr == "not slow"
    return (os.cpu_count() or 1) + (not quick)


# Linux grants a process 65,530 memory mappings; each compiled function takes about ten of them.
# Dropping them takes seconds, and the next tests trace and compile their functions anew.
MOST_MAPPINGS = 30_000
TESTS_BETWEEN = 20  # counting tens of thousands of mappings takes a few hundredths of a second

_tests = itertools.count(1)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Check the first calls of this test."""
    global _most
    drawn = getattr(getattr(item, "function", None), "is_hypothesis_test", False)
    _most = CHECKS * (settings().max_examples if drawn else 1)
    _calls.clear()


def pytest_runtest_teardown() -> None:
    """Drop compiled functions before they exceed the system's limit."""
    mappings = Path("/proc/self/maps")
    if next(_tests) % TESTS_BETWEEN or not mappings.exists():
        return
    if mappings.read_bytes().count(b"\n") > MOST_MAPPINGS:
        jax.clear_caches()
        gc.collect()


def _shared() -> Path | None:
    """Find the folder with research data beside the checkout; None without it."""
    named = os.environ.get("CATFREE_SHARED")
    candidates = [Path(named)] if named else [Path(__file__).parents[2] / "shared"]
    return next((path for path in candidates if (path / "data").is_dir()), None)


SHARED = _shared()


@pytest.fixture(scope="session")
def shared() -> Path:
    """Return the research data, or skip with a reason."""
    if SHARED is None:
        pytest.skip(
            "research data not found: set CATFREE_SHARED or put shared/ beside the checkout"
        )
    return SHARED


@pytest.fixture
def x64():
    """Run a test in float64 without changing global state for others."""
    with jax.enable_x64(True):
        yield
