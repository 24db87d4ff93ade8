"""Run one attempt, which must succeed or raise a one-sentence error, and count the outcomes."""

import collections
import contextlib
import dataclasses
import signal
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from catfree.errors import CatFreeError
from catfree.methods.online import TrackerState
from catfree.methods.online._tracker_state import Learned
from catfree.types import Candidates, Reliability, Rig, Thresholds, Tracks

LONGEST = 5.0  # seconds of this process, independent of other load
LONGEST_MESSAGE = 1000  # characters, without the path
COLUMNS = ("clean error", "valid", "absent", "traceback", "silent NaN", "hang", "loss")
FAILURES = ("traceback", "silent NaN", "hang", "loss")
_Excuse = Callable[[Any, np.ndarray], Any]


@dataclasses.dataclass
class Tally:
    """Outcomes by row of the table, with descriptions of a few failures."""

    rows: dict[str, collections.Counter[str]] = dataclasses.field(default_factory=dict)
    examples: list[str] = dataclasses.field(default_factory=list)

    def count(self, row: str, outcome: str, detail: str = "") -> None:
        """Count one outcome."""
        self.rows.setdefault(row, collections.Counter())[outcome] += 1
        if outcome in FAILURES and self.rows[row][outcome] <= 3:
            self.examples.append(f"{row}: {outcome}: {detail}")

    def attempt(
        self,
        row: str,
        action: Callable[[], Any],
        *,
        detail: str = "",
        folder: Path | None = None,
        same: Callable[[Any], bool] | None = None,
        absent: bool = False,
    ) -> None:
        """Call an action that must return sound values or raise one `CatFreeError`.

        Args:
            row: row of the table.
            action: called without arguments.
            detail: how to repeat the call.
            folder: folder whose name does not count in the length of messages.
            same: whether a returned value is right, if that can be decided.
            absent: whether None is a valid answer.
        """
        start = time.process_time()
        try:
            with _deadline(), warnings.catch_warnings():
                warnings.simplefilter("error")
                value = action()
                fault = unsound(value)
        except CatFreeError as error:
            text = str(error).replace(str(folder), "").replace("x/" * 2990, "")
            long = len(text) > LONGEST_MESSAGE
            outcome, more = (
                ("traceback", f"{len(text)} characters") if long else ("clean error", "")
            )
        except _Late:
            outcome, more = "hang", f"more than {LONGEST} s"
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            outcome, more = "traceback", f"{type(error).__name__}: {str(error)[:200]} at {place}"
        else:
            if value is None and absent:
                outcome, more = "absent", ""
            elif fault is not None:
                outcome, more = "silent NaN", fault
            elif same is not None and not same(value):
                outcome, more = "loss", "silently different"
            else:
                outcome, more = "valid", ""
        if time.process_time() - start > LONGEST:
            outcome, more = "hang", f"{time.process_time() - start:.1f} s"
        self.count(row, outcome, f"{detail} {more}")

    @property
    def failures(self) -> int:
        """Number of outcomes that must not occur."""
        return sum(row[outcome] for row in self.rows.values() for outcome in FAILURES)

    def __str__(self) -> str:
        width = max(map(len, self.rows), default=0)
        head = f"{'':{width}}" + "".join(f"{name:>13}" for name in ("tries", *COLUMNS))
        total = sum(self.rows.values(), collections.Counter())
        lines = [head]
        for name, row in [*self.rows.items(), ("all", total)]:
            values = (row.total(), *(row[column] for column in COLUMNS))
            lines.append(f"{name:{width}}" + "".join(f"{value:>13}" for value in values))
        return "\n".join([*lines, *self.examples])


def unsound(value: Any, name: str = "value") -> str | None:
    """Find the first place with NaN, infinity or no real numbers; None if all are sound."""
    if isinstance(value, Rig):
        value = dict(vars(value.select(value.registered)))
    if isinstance(value, np.ndarray | jax.Array | float | complex):
        array = np.asarray(value)
        if array.dtype.kind not in "biufU":
            return f"{name} has type {array.dtype}"
        real = array.dtype.kind != "f" or bool(np.isfinite(array).all())
        return None if real else f"{name} is not finite"
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        value = {field: _known(value, field) for field in names}
    elif isinstance(value, tuple | list):
        value = {str(at): item for at, item in enumerate(value)}
    if isinstance(value, dict):
        return next((f for k, v in value.items() if (f := unsound(v, f"{name}.{k}"))), None)
    return None


def _known(owner: Any, name: str) -> Any:
    """Read a field of a dataclass, with zeros for values that its docstring calls unknown."""
    value, excuse = getattr(owner, name), _DOCUMENTED.get(type(owner), {}).get(name)
    if excuse is None or not isinstance(value, np.ndarray | float):
        return value
    numbers = np.asarray(value)
    return np.where(excuse(owner, numbers), 0.0, numbers) if numbers.dtype.kind == "f" else value


def _nan(owner: Any, value: np.ndarray) -> Any:
    return np.isnan(value)


def _infinite(owner: Any, value: np.ndarray) -> Any:
    return np.isposinf(value)


def _too_few_rays(owner: Candidates, value: np.ndarray) -> Any:
    return np.isnan(value) & np.isposinf(owner.sigma)


def _too_few_cameras(owner: Tracks, value: np.ndarray) -> Any:
    unknown = np.isposinf(owner.sigma) & (owner.supporting_cameras < 2)
    return unknown.reshape(-1, *[1] * (value.ndim - 1)) & ~np.isneginf(value)


def _median_of_unknown(owner: Reliability, value: np.ndarray) -> Any:
    return np.isnan(value) | (np.isposinf(value) & np.isposinf(owner.median_sigma))


def _no_estimate(owner: Reliability, value: np.ndarray) -> Any:
    estimate = owner.expected_moda
    return np.isnan(value) & (estimate is not None and np.isnan(estimate))


# The NaN and infinities that the docstrings of the types permit; all others are faults.
_DOCUMENTED: dict[type, dict[str, _Excuse]] = {
    Candidates: {
        "sigma": _infinite,
        "ground_distance": _too_few_rays,
        "rms_angle": _too_few_rays,
    },
    Reliability: {
        "median_sigma": _median_of_unknown,
        "sigma_over_radius": _median_of_unknown,
        "expected_precision": _nan,
        "expected_recall": _nan,
        "expected_moda": _nan,
        "moda_low": _no_estimate,
        "moda_high": _no_estimate,
        "ground_height": _nan,
        "least_together": _nan,
    },
    Thresholds: {"extension_appearance": _infinite},
    Tracks: {
        "sigma": _too_few_cameras,
        "covariance": _too_few_cameras,
        "velocity": _nan,
        "velocity_covariance": lambda owner, value: np.isnan(value) | np.isposinf(value),
    },
    Learned: dict.fromkeys(("unit", "step", "usual"), _nan),
    TrackerState: {"final_time": _nan},
}


class _Late(BaseException):
    pass


@contextlib.contextmanager
def _deadline() -> Iterator[None]:
    def late(number: int, frame: Any) -> None:
        raise _Late

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
