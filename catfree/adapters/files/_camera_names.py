"""Distinct camera names from file names, and file names from camera names."""

import os
import re
import unicodedata
from collections.abc import Callable, Collection, Sequence
from pathlib import Path, PurePosixPath

from catfree.errors import InvalidInputError
from catfree.types._validation import is_text

# Folders before the file in a camera name; with more it would be a path, not a name.
DEEPEST = 3
# Bytes of a file's name before its suffix; file systems allow 255 in total.
LONGEST = 200

# Endings of the names of cameras that are files: images, videos, boxes.
_ENDINGS = re.compile(
    r"\.(png|jpe?g|bmp|tiff?|webp|mp4|avi|mov|mkv|webm|txt|csv|json|parquet|npz|ya?ml|xml)$",
    re.IGNORECASE,
)


def require_readable_name(path: Path) -> None:
    """Raise if a path is not UTF-8: OpenCV cannot open it, and results cannot name its camera.

    Raises:
        InvalidInputError: showing the path with its bytes escaped.
    """
    if not is_text(str(path)):
        raise InvalidInputError(
            f"The path {str(path)!a} is not valid UTF-8, so it cannot be opened as a video or "
            "named in a result. Rename it."
        )


def names_of_files(paths: Sequence[Path]) -> list[str]:
    """Make one distinct name per camera: its file's, with folders or suffix if necessary.

    Args:
        paths: (C,) files or image folders.

    Returns:
        (C,) names such as `video`, `cam1/video`, `video.mp4`, or `C1_video` where neither folders
        nor suffixes distinguish the files.

    Raises:
        InvalidInputError: if two paths lead to the same file or folder.
    """
    camera_of: dict[Path, int] = {}
    for camera, path in enumerate(paths):
        first = camera_of.setdefault(path.resolve(), camera)
        if first != camera:
            raise InvalidInputError(
                f"Cameras {first} and {camera} are the same file, {path}. Name each file once."
            )
    places = [Path(os.path.abspath(path)) for path in paths]
    bare = [place.with_suffix("") if place.is_file() else place for place in places]
    for candidates in (bare, places):
        for depth in range(1, DEEPEST + 1):
            names = ["/".join(_parts(place)[-depth:]) for place in candidates]
            if all(names) and len(set(names)) == len(names):
                return names
    return [f"C{camera + 1}_{place.name}" for camera, place in enumerate(bare)]


def _parts(place: Path) -> tuple[str, ...]:
    """List folders and file below the root; bytes that are not UTF-8 become question marks."""
    below = place.parts[1:] if place.anchor else place.parts
    return tuple(part.encode("utf-8", "replace").decode() for part in below)


def positions_of(wanted: Sequence[str], given: Sequence[str]) -> list[int] | None:
    """Find cameras by name: exactly, without endings and case, or by file or folder.

    Args:
        wanted: names of the cameras to find.
        given: (C,) names of all cameras: `C1.png` and `C1/det.txt` are the camera `c1`.

    Returns:
        For each wanted camera its position among the given ones, or None if the names do not
        identify them.
    """
    rules: tuple[Callable[[str], str], ...] = (
        lambda name: name,
        lambda name: _ENDINGS.sub("", _folded(name)),
        lambda name: PurePosixPath(_ENDINGS.sub("", _folded(name))).name,
        lambda name: (PurePosixPath(_folded(name)).parts or ("",))[0],
    )
    for left in rules:
        for right in rules:
            sought, known = [left(name) for name in wanted], [right(name) for name in given]
            if len(set(sought)) == len(sought) and set(sought) <= set(known):
                place = [known.index(name) for name in sought]
                if all(known.count(name) == 1 for name in sought):
                    return place
    return None


def _folded(name: str) -> str:
    """Remove case, and unify ü as one character and as u with dots (macOS)."""
    return unicodedata.normalize("NFC", name.casefold())


def numbered_names(count: int) -> tuple[str, ...]:
    """Return the names C1, C2, ... of cameras that have none."""
    return tuple(f"C{camera + 1}" for camera in range(count))


def plain_numbers(count: int) -> tuple[str, ...]:
    """Return the numbers 0, 1, ... by which tables and lines name cameras that have no names."""
    return tuple(map(str, range(count)))


def is_numbered(names: Sequence[str]) -> bool:
    """Return whether the names are the placeholders C1, C2, ... of cameras without names."""
    return tuple(names) == numbered_names(len(names))


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """Make a sort key by which `image2` comes before `image10`."""
    pieces = [piece for piece in re.split(r"(\d+)", name) if piece]
    # Of two whole numbers without leading zeros, the longer is larger, however long both are.
    digits = [piece.lstrip("0") if piece.isdecimal() else None for piece in pieces]
    return [
        (1, 0, piece.lower()) if number is None else (0, len(number), number)
        for piece, number in zip(pieces, digits, strict=True)
    ]


def files_ending(folder: Path, suffixes: Collection[str]) -> list[Path]:
    """List the files of a folder with some suffixes in natural order, without hidden ones."""
    files = (path for path in folder.iterdir() if path.suffix.lower() in suffixes)
    visible = (path for path in files if not path.name.startswith("."))
    return sorted(visible, key=lambda path: natural_order(path.name))


def file_names(names: Sequence[str]) -> list[str]:
    """Make distinct file names for one folder, one per camera.

    Args:
        names: (C,) camera names, which may be parts of paths.

    Returns:
        (C,) the names with `_` in place of folder separators, cut to the length that file systems
        allow, and made distinct by `distinct_names`.
    """
    plain = ("".join("_" if c in "/\\:\0" else c for c in name).lstrip(".") for name in names)
    encoded = (name.encode("utf-8", "replace") for name in plain)
    return distinct_names([name[:LONGEST].decode("utf-8", "ignore") for name in encoded])


def distinct_names(names: Sequence[str]) -> list[str]:
    """Make names distinct on any file system.

    An empty or repeated name gets the number of its camera.

    Args:
        names: (C,) names derived from distinct ones.
    """
    taken = {name.casefold() for name in names}
    used, labels = {""}, []
    for camera, name in enumerate(names):
        label = name
        while label.casefold() in used or (label != name and label.casefold() in taken):
            label = f"{label}_C{camera + 1}"
        used.add(label.casefold())
        labels.append(label)
    return labels
