"""Checks shared by all packages; each names the first offending entry."""

import dataclasses
import errno
import json
import os
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import AbstractArray, Bool, jaxtyped

from catfree.errors import InvalidInputError, quoted, shortened

T = TypeVar("T")

FEWEST_TWINS = 10  # boxes or pictures of a camera; fewer may coincide by chance
LARGEST_PIXEL = 1e9  # of a corner; images have up to some 1e5, and larger squares overflow
MOST_OUTSIDE = 0.25  # share of a camera's boxes: people who are mostly out of view
MOST_BOXES = 5000  # at an instant: the densest benchmark crowd seen by 20 cameras
MOST_PEOPLE = 1000  # in a picture: benchmarks of dense crowds have up to 250


def is_traced(*values: Any) -> bool:
    """Return whether any value is a JAX tracer, whose entries cannot be inspected."""
    return any(isinstance(value, jax.core.Tracer) for value in values)


def entry_of(name: str, bad: Any) -> str:
    """Name the first true entry of a boolean array, such as `score[3]`; a scalar is just `name`."""
    index = ", ".join(map(str, np.argwhere(bad)[0].tolist()))
    return f"{name}[{index}]" if index else name


def refuse(bad: Any, values: np.ndarray, name: str, fault: str) -> None:
    """Raise if any entry or row is bad, with a message such as `score[3] is 1.5; it must be ...`.

    Args:
        bad: marks the bad entries.
        values: the array.
        name: name of the array.
        fault: text of the message after the value.

    Raises:
        InvalidInputError: naming the first one.
    """
    if np.any(bad):
        value = values[tuple(np.argwhere(bad)[0])]
        shown = value.tolist() if value.ndim else value
        raise InvalidInputError(f"{entry_of(name, bad)} is {shown}{fault}")


def require_instance(value: Any, kind: type, name: str) -> None:
    """Raise unless `value` has this type, to catch swapped or missing arguments."""
    if not isinstance(value, kind):
        held = sum(isinstance(item, kind) for item in value) if type(value) in (list, tuple) else 0
        also = f" that holds {held} of them: pass one" if held else ""
        part = kind.__name__.lower()
        if isinstance(value, str | os.PathLike) and part in ("scene", "detections"):
            also = f": read it with cf.read_{part}"
        elif hasattr(value, "columns") and hasattr(kind, "from_table"):
            also = f": make one with cf.{kind.__name__}.from_table"
        elif isinstance(getattr(value, part, None), kind):
            also = f". Pass its .{part}"
            also += " and, as names, its .names" if hasattr(value, "names") else ""
        raise InvalidInputError(
            f"{name} must be a {kind.__name__}, got {type(value).__name__}{also}."
        )


def as_path(value: Any, name: str) -> Path:
    """Convert text or a path object to a `Path`, expanding `~`.

    Raises:
        InvalidInputError: if it is neither, or not a possible path.
    """
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str):
        raise InvalidInputError(f"{name} must be a path, got {type(value).__name__}.")
    if not text:  # e.g. an unset variable; pathlib would take it for the current folder
        raise InvalidInputError(f"{name} is empty. Give a path, or '.' for the current folder.")
    text = os.path.expanduser(text)
    try:
        os.lstat(text)
    except ValueError as error:  # NUL, or half a surrogate pair
        raise InvalidInputError(
            f"{name} is {quoted(text)}, which has a character that paths cannot have. Remove it."
        ) from error
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise InvalidInputError(
                f"{name} is {quoted(text)}, which is too long for a path. Shorten it."
            ) from error
    return Path(text)


def is_listed(value: Any) -> bool:
    """Return whether a value is a collection; text, mappings and 0-d arrays are not."""
    has_entries = isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
    return has_entries and getattr(value, "shape", None) != ()


def as_paths(value: Any, name: str) -> list[Path]:
    """Convert one path or several to a list."""
    if isinstance(value, str | os.PathLike) or not is_listed(value):
        return [as_path(value, name)]
    return [as_path(one, f"{name}[{at}]") for at, one in enumerate(value)]


def as_instances(values: Any, kind: type[T], name: str) -> list[T]:
    """Return a list of values that must all have this type."""
    if not is_listed(values):
        raise InvalidInputError(
            f"{name} must be a list of {kind.__name__}, got {type(values).__name__}."
        )
    listed = list(values)
    for at, value in enumerate(listed):
        require_instance(value, kind, f"{name}[{at}]")
    return listed


def require_names(
    names: Any, cameras: int, name: str = "camera_names", *, distinct: bool = False
) -> None:
    """Raise unless there is one name per camera, or no names at all.

    Args:
        names: camera names, or None.
        cameras: number of cameras.
        name: name of the argument, for messages.
        distinct: whether names must be distinct text.

    Raises:
        InvalidInputError: naming the argument.
    """
    if names is None:
        return
    if not (is_listed(names) and hasattr(names, "__len__") and hasattr(names, "__getitem__")):
        raise InvalidInputError(f"{name} must be a list, got {type(names).__name__}.")
    if len(names) != cameras:
        raise InvalidInputError(f"{name} has {len(names)} names, but there are {cameras} cameras.")
    if not distinct:
        return
    for camera, one in enumerate(names):
        if not (isinstance(one, str) and is_text(one)):
            raise InvalidInputError(
                f"The name of camera {camera} is {shortened(ascii(one))}; it must be text that "
                "UTF-8 can hold."
            )
    if len(set(names)) < len(names):
        raise InvalidInputError(
            f"Two cameras have the same name: {shortened(', '.join(names))}. Rename one of them."
        )


def parse_json(text: str | bytes | bytearray) -> Any:
    """Parse JSON, refusing duplicate keys, of which one value would be lost.

    Raises:
        ValueError: if it is not JSON, or has a duplicate key.
    """

    def distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        entries = dict(pairs)
        if len(entries) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise ValueError(f"{quoted(twice)} is stated twice")
        return entries

    return json.loads(text, object_pairs_hook=distinct)


def is_text(name: str) -> bool:
    """Return whether a name can be encoded as UTF-8; paths in another encoding cannot."""
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def _rows_in(value: Any) -> str | None:
    """Return the expression that yields rows of numbers from a result, if any."""
    for part in ("", "tracks", "localization.tracks"):
        held = value
        for name in filter(None, part.split(".")):
            held = getattr(held, name, None)
        if hasattr(held, "to_rows"):
            return f"{part}.to_rows()".lstrip(".")
    return None


def _as_array(value: Any) -> np.ndarray:
    if not isinstance(value, np.ndarray | list | tuple) and (part := _rows_in(value)):
        raise InvalidInputError(
            f"Expected an array of numbers, got {type(value).__name__}. Pass its {part}."
        )
    if np.ma.is_masked(value):
        raise InvalidInputError(
            "Expected an array, got one with masked entries, whose mask would be ignored. Leave "
            "them out (compressed), or give them a value (filled)."
        )
    try:
        return np.asarray(value)
    except ValueError as error:
        raise InvalidInputError(
            "Expected an array, got lists of different lengths. Give every row the same length."
            if isinstance(value, list | tuple)
            else f"Expected an array of numbers, got {type(value).__name__}."
        ) from error


def _require_real(dtype: Any) -> None:
    """Raise for dates, and for complex numbers, which would lose their imaginary part."""
    if np.dtype(dtype).kind in "cmM":
        raise InvalidInputError(f"Expected real numbers, got {dtype} values.")


def as_float(value: Any, name: str | None = None) -> Any:
    """Convert to floats: float arrays keep their width, JAX arrays stay JAX arrays.

    Other numbers become float64, and JAX arrays of whole numbers become JAX's default float.

    Args:
        value: the argument.
        name: name of the argument, for messages.

    Raises:
        InvalidInputError: if these are not real numbers.
    """
    try:
        return _as_float(value)
    except InvalidInputError as error:
        raise error if name is None else InvalidInputError(f"{name}: {error}") from error


def _as_float(value: Any) -> Any:
    if value is None:  # NumPy would make it NaN
        raise InvalidInputError("Expected numbers, got NoneType.")
    if isinstance(value, jax.Array):
        _require_real(value.dtype)
        return value if value.dtype in (jnp.float32, jnp.float64) else value.astype(float)
    array = _as_array(value)
    _require_real(array.dtype)
    if array.dtype.kind == "f":
        array = array.astype(array.dtype.newbyteorder("="), copy=False)
    if array.dtype not in (np.float32, np.float64):
        try:
            texts = array.flat if array.dtype.kind in "SUVO" else ()
            if any(isinstance(one, str | bytes | np.void) for one in texts):
                raise TypeError("text")  # NumPy would parse its digits, truncated to the item width
            array = array.astype(np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            kind = f"{array.dtype} values" if array.ndim else type(value).__name__
            raise InvalidInputError(f"Expected numbers, got {kind}.") from error
    return array


def as_integer(value: Any, name: str) -> np.ndarray:
    """Convert to int64; whole-number floats are accepted, fractions are not."""
    array = _as_array(value)
    if array.size == 0:
        return array.astype(np.int64)
    if array.dtype.kind not in "iuf":
        raise InvalidInputError(f"{name} must hold whole numbers, got dtype {array.dtype}.")
    # 2^63 and beyond would wrap around in int64.
    if array.dtype.kind == "f":
        wide = array.astype(np.float64)  # 2^63 is beyond half precision
        bad = ~(np.abs(wide) < 2.0**63) | (wide != np.round(wide))
    else:
        bad = array > np.iinfo(np.int64).max
    refuse(bad, array, name, "; it must be a whole number of at most 63 bits.")
    return array.astype(np.int64)


def as_count(value: Any, name: str, *, least: int | None = None) -> int:
    """Convert to one integer of at least `least`, such as a position or a stride."""
    array = as_integer(value, name)
    if array.shape != ():
        raise InvalidInputError(f"{name} must be one whole number, got shape {array.shape}.")
    if least is not None and array < least:
        raise InvalidInputError(f"{name} is {array}; it must be {least} or more.")
    return int(array)


def as_positive(value: Any, name: str) -> float:
    """Return a finite number above 0 as a float.

    Raises:
        InvalidInputError: if it is anything else.
    """
    return _as_number(value, name, "a positive number", above=0.0)


def as_number(value: Any, name: str) -> float:
    """Return a finite number as a float.

    Raises:
        InvalidInputError: if it is anything else.
    """
    return _as_number(value, name, "a finite number")


def as_duration(value: Any, name: str) -> float:
    """Return a finite number of seconds, 0 or more, as a float.

    Raises:
        InvalidInputError: if it is anything else.
    """
    return _as_number(value, name, "a number of seconds, 0 or more", least=0.0)


def _as_number(
    value: Any, name: str, meaning: str, *, least: float = -np.inf, above: float = -np.inf
) -> float:
    """Return one finite number that is at least `least` and above `above`."""
    number = _as_array(value)
    is_number = number.shape == () and number.dtype.kind in "fiu" and bool(np.isfinite(number))
    if not (is_number and number >= least and number > above):
        given = number.item() if number.shape == () else value
        raise InvalidInputError(f"{name} is {quoted(given)}; it must be {meaning}.")
    return float(number)


def as_finite(value: Any, shape: tuple[int | None, ...], name: str) -> np.ndarray:
    """Convert to finite float64 of this shape, in which None stands for any length."""
    array = np.asarray(as_float(value, name), np.float64)
    require_shape(array, shape, name)
    require_finite(array, name)
    return array


def as_area(value: Any, *, finite: bool = True) -> tuple[float, float, float, float]:
    """Return x_min, x_max, y_min, y_max of an area, or of a mapping with the pairs x and y.

    Args:
        value: the argument.
        finite: whether the bounds must be finite.

    Raises:
        InvalidInputError: if it has another form, or is empty.
    """
    try:
        bounds = [*value["x"], *value["y"]] if isinstance(value, Mapping) else list(value)
        x_min, x_max, y_min, y_max = (float(bound) for bound in bounds)
    except (KeyError, OverflowError, TypeError, ValueError):
        x_min = x_max = y_min = y_max = np.nan
    sides = np.array([x_max - x_min, y_max - y_min])
    if not (sides > 0).all() or (finite and not np.isfinite(sides).all()):
        raise InvalidInputError(
            f"area is {quoted(value)}; it must be (x_min, x_max, y_min, y_max), or a mapping with "
            f"the ranges x and y, with min < max{', all finite' if finite else ''}."
        )
    return x_min, x_max, y_min, y_max


def as_rows(value: Any, width: int, name: str) -> np.ndarray:
    """Convert to floats of shape (N, width) on the host; empty input becomes (0, width)."""
    rows = np.asarray(as_float(value, name))
    rows = rows.reshape(0, width) if rows.size == 0 else rows
    require_shape(rows, (None, width), name)
    return rows


def as_boolean(value: Any, name: str) -> np.ndarray:
    """Convert booleans, or 0 and 1, to a bool array."""
    array = _as_array(value)
    if array.dtype == bool:
        return array
    if array.size and array.dtype.kind not in "iuf":
        raise InvalidInputError(f"{name} must hold true and false, got dtype {array.dtype}.")
    bad = ~np.isin(array, (0, 1))
    if bad.any():
        raise InvalidInputError(f"{entry_of(name, bad)} is neither true nor false.")
    return array.astype(bool)


def as_flag(value: Any, name: str) -> bool:
    """Convert one boolean, or 0 or 1, to a bool."""
    flag = as_boolean(value, name)
    require_shape(flag, (), name)
    return bool(flag)


def as_registered(registered: Any, cameras: int) -> Bool[np.ndarray, " cam"]:
    """Return the mask of registered cameras; None stands for all."""
    flags = np.ones(cameras, bool) if registered is None else as_boolean(registered, "registered")
    require_shape(flags, (cameras,), "registered")
    return flags


def require_shape(value: Any, shape: tuple[int | None, ...], name: str) -> None:
    """Raise unless `value` has this shape, in which None stands for any length."""
    actual = np.shape(value)
    if len(actual) != len(shape) or any(
        s is not None and g != s for g, s in zip(actual, shape, strict=True)
    ):
        expected = ", ".join("n" if s is None else str(s) for s in shape)
        raise InvalidInputError(f"{name} must have shape ({expected}), got {actual}.")


def require_boxes(
    count: int,
    box: np.ndarray,
    score: np.ndarray | None,
    keypoints: np.ndarray | None,
) -> None:
    """Raise if a box is bad, a score is outside [0, 1], or a number is not finite.

    A box is bad if it has no area, or lies farther out than any image reaches.

    Args:
        count: N, the number of boxes.
        box: (N, 4) x1, y1, x2, y2.
        score: (N,) or None.
        keypoints: (N, 17, 3) or None.
    """
    require_shape(box, (count, 4), "box")
    require_finite(box, "box")
    far = (np.abs(box) > LARGEST_PIXEL).any(axis=1)
    refuse(far, box, "box", f"; corners lie within {LARGEST_PIXEL:g} pixels.")
    empty = (box[:, 2] <= box[:, 0]) | (box[:, 3] <= box[:, 1])
    refuse(empty, box, "box", "; it must be x1 < x2, y1 < y2 in pixels (xyxy, not xywh).")
    if score is not None:
        require_shape(score, (count,), "score")
        require_finite(score, "score")
        refuse((score < 0) | (score > 1), score, "score", "; it must be in [0, 1].")
    if keypoints is not None:
        require_shape(keypoints, (count, 17, 3), "keypoints")
        require_finite(keypoints, "keypoints")


def require_known_cameras(camera: np.ndarray, count: int) -> None:
    """Raise if a camera is not in a rig of `count` cameras."""
    refuse(camera < 0, camera, "camera", "; indices start at 0.")
    fault = (
        f", but the rig has {count} cameras, 0 to {count - 1}. Pass the rig that the detections "
        "were made with."
    )
    refuse(camera >= count, camera, "camera", fault)


def require_few_people(
    frame: np.ndarray, camera: np.ndarray, names: Sequence[str] | None = None
) -> None:
    """Raise if a picture or an instant has more boxes than any crowd would.

    Then the frame numbers are missing, or the boxes are a detector's raw output.

    Args:
        frame: (N,) frame numbers.
        camera: (N,) camera indices.
        names: of the cameras, for the message.
    """
    if len(frame) <= MOST_PEOPLE:
        return
    frames, instant = np.unique(frame, return_inverse=True)
    shape = len(frames), int(camera.max()) + 1
    count = np.bincount(instant * shape[1] + camera, minlength=shape[0] * shape[1]).reshape(shape)
    at, camera_index = divmod(int(np.argmax(count)), shape[1])
    fullest = int(np.argmax(count.sum(1)))
    if count[at, camera_index] > MOST_PEOPLE:
        crowd = (
            f"Camera {shown_camera(camera_index, names)} has {count[at, camera_index]} boxes in "
            f"frame {frames[at]}; a picture shows at most {MOST_PEOPLE} people."
        )
    elif count[fullest].sum() > MOST_BOXES:
        crowd = (
            f"Frame {frames[fullest]} has {count[fullest].sum()} boxes in "
            f"{np.count_nonzero(count[fullest])} cameras; all cameras together may have at most "
            f"{MOST_BOXES}."
        )
    else:
        return
    raise InvalidInputError(
        f"{crowd} Check that `frame` numbers the pictures, and that the detector drops boxes of "
        "low score and duplicate boxes of one person."
    )


def shown_camera(camera: int, names: Sequence[str] | None) -> str:
    """Return the name of a camera for a message, or its number if it has none."""
    return str(camera) if names is None or camera >= len(names) else quoted(names[camera])


def require_different_cameras(
    frame: np.ndarray, camera: np.ndarray, box: np.ndarray, names: Sequence[str] | None = None
) -> None:
    """Raise if two cameras have the same boxes in all frames: one video under two names.

    Such cameras agree perfectly, so no residual reveals that one of them does not exist.

    Args:
        frame: (N,) frame numbers.
        camera: (N,) camera indices.
        box: (N, 4) boxes; cameras with fewer than `FEWEST_TWINS` are not compared.
        names: of the cameras, for the message.
    """
    count = np.bincount(camera)
    alike = np.bincount(count)[count] > 1  # sorting is slow; most cameras differ in number
    first: dict[bytes, int] = {}
    for one in np.flatnonzero(alike & (count >= FEWEST_TWINS)).tolist():
        rows = np.column_stack([frame[camera == one], box[camera == one]])
        key = rows[np.lexsort(rows.T)].tobytes()
        if key in first:
            name, other = (shown_camera(c, names) for c in (first[key], one))
            raise InvalidInputError(
                f"Cameras {name} and {other} have the same {len(rows)} boxes: one video was "
                "read twice. Pass each camera once."
            )
        first[key] = one


def require_changing_pictures(
    frame: np.ndarray, camera: np.ndarray, box: np.ndarray, names: Sequence[str] | None = None
) -> None:
    """Raise if one camera, but not all, has exactly the same boxes in every picture.

    Noise changes every new picture, and so its boxes.

    Args:
        frame: (N,) frame numbers.
        camera: (N,) camera indices.
        box: (N, 4) boxes; cameras with boxes in fewer than `FEWEST_TWINS` frames are not judged.
        names: of the cameras, for the message.
    """
    still, changing = {}, False
    for one in np.unique(camera).tolist():
        frames, picture = np.unique(frame[camera == one], return_inverse=True)
        boxes = box[camera == one]
        shape = len(frames), len(boxes) // len(frames)
        same = shape[0] * shape[1] == len(boxes)
        if same:
            order = np.lexsort((*boxes.T, picture))
            pictures, boxes = picture[order].reshape(shape), boxes[order].reshape(*shape, 4)
            same = bool((pictures == pictures[:, :1]).all() and (boxes == boxes[:1]).all())
        if not same:
            changing = True
        elif len(frames) >= FEWEST_TWINS:
            still[one] = shape
    if still and changing:
        one, (frames, count) = next(iter(still.items()))
        raise InvalidInputError(
            f"Camera {shown_camera(one, names)} has exactly the same boxes ({count}) in all its "
            f"{frames} frames with boxes, but those of other cameras change: its picture is "
            "frozen, or shows nobody. Look at it; if it is frozen, leave out these boxes, and pass "
            "its pictures as silent."
        )


def as_pictures(silent: Any) -> np.ndarray:
    """Return (K, 2) integers, frame and camera of each listed picture; K is 0 for None.

    Raises:
        InvalidInputError: if the rows are not pairs of integers.
    """
    rows = as_integer(() if silent is None else silent, "silent")
    rows = rows.reshape(0, 2) if rows.size == 0 else rows
    require_shape(rows, (None, 2), "silent")
    return rows


def require_no_boxes(
    silent: np.ndarray,
    frame: np.ndarray,
    camera: np.ndarray,
    names: Sequence[str] | None = None,
) -> None:
    """Raise if a picture that is listed as missing has a box.

    Args:
        silent: (K, 2) frame and camera of the missing pictures.
        frame: (N,) frame of each box.
        camera: (N,) camera of each box.
        names: of the cameras, for the message.
    """
    if not len(silent):
        return
    boxes = np.unique(np.column_stack([frame, camera]), axis=0)
    pictures, count = np.unique(
        np.concatenate([boxes, np.unique(silent, axis=0)]), axis=0, return_counts=True
    )
    if (count > 1).any():
        at, camera_index = pictures[count > 1][0].tolist()
        raise InvalidInputError(
            f"silent says that camera {shown_camera(camera_index, names)} has no picture of "
            f"frame {at}, but there is a box in it. Remove one of the two."
        )


def require_boxes_in_images(
    camera: np.ndarray,
    box: np.ndarray,
    image_size: np.ndarray,
    names: Sequence[str] | None = None,
) -> None:
    """Raise if many boxes of a camera have their center outside its image.

    Then the image size is wrong, and the principal point with it. A rig that fits such boxes is
    off, and its residuals do not show it.

    Args:
        camera: (N,) camera indices.
        box: (N, 4) boxes; cameras with fewer than `FEWEST_TWINS` are not judged.
        image_size: (C, 2) widths and heights in pixels.
        names: of the cameras, for the message.

    Raises:
        InvalidInputError: naming the first such camera.
    """
    center = (box[:, :2] + box[:, 2:]) / 2
    outside = ((center < 0) | (center > image_size[camera])).any(axis=1)
    count = np.bincount(camera, minlength=len(image_size))
    share = np.bincount(camera, outside, len(image_size)) / np.maximum(count, 1)
    wrong = np.flatnonzero((count >= FEWEST_TWINS) & (share > MOST_OUTSIDE))
    if not len(wrong):
        return
    at = int(wrong[0])
    name, (width, height) = shown_camera(at, names), (int(side) for side in image_size[at])
    raise InvalidInputError(
        f"{share[at]:.0%} of the boxes of camera {name} have their center outside "
        f"its image of {width} x {height} px. Pass the size (width, height) of the images that "
        "the boxes were found in, one row per camera if they differ."
    )


def require_finite(value: Any, name: str, where: np.ndarray | None = None) -> None:
    """Raise if there is a NaN or infinity in the rows where `where` is true."""
    bad = np.asarray(~np.isfinite(np.asarray(value)))
    if where is not None:
        bad = bad & where.reshape(where.shape + (1,) * (bad.ndim - where.ndim))
    if bad.any():
        raise InvalidInputError(f"{entry_of(name, bad)} is not finite. Remove or repair it first.")


def options_of(hint: Any) -> tuple[Any, ...]:
    """Return the members of a union, or the type itself."""
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if union else (hint,)


def require_declared_types(kind: type, values: Mapping[str, Any]) -> None:
    """Raise unless arrays and numbers match the declared fields of a dataclass.

    An axis name stands for one length in all fields, so columns of unequal length also raise.

    Args:
        kind: the dataclass.
        values: field name to value.

    Raises:
        InvalidInputError: naming the first field.
    """
    hints = typing.get_type_hints(kind)
    with jaxtyped("context"):
        for field in dataclasses.fields(kind):
            if field.name not in values:
                continue
            item, options = values[field.name], options_of(hints[field.name])
            types_only = (o for o in options if isinstance(o, type))
            arrays = tuple(o for o in types_only if issubclass(o, AbstractArray))
            if item is None and types.NoneType in options:
                continue
            if arrays and not isinstance(item, arrays):
                given = f"shape {getattr(item, 'shape', '?')}, type {getattr(item, 'dtype', '?')}"
                raise InvalidInputError(
                    f"{field.name} ({given}) does not fit the other columns or the "
                    f"{arrays[0].__name__} that belongs there."
                )
            plain = tuple(o for o in options if o in (bool, int, float, str))
            if plain and not isinstance(item, (*plain, int) if float in plain else plain):
                raise InvalidInputError(f"{field.name} is {quoted(item)}, not {plain[0].__name__}.")
