"""Distinct camera names made from file names, and file names made from camera names."""

import os
from collections.abc import Sequence
from pathlib import Path

from catfree.errors import InvalidInputError

# Folders before the file in a camera name; with more it would be a path, not a name.
DEEPEST = 3
# Bytes of a file's name before its suffix; file systems allow 255 in total.
LONGEST = 200


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


def is_text(name: str) -> bool:
    """Return whether a name can be written as UTF-8; paths in another encoding cannot."""
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def names_of_files(paths: Sequence[Path]) -> list[str]:
    """Make one distinct name per camera: its file's, with folders or suffix if necessary.

    Args:
        paths: (C,) files or image folders.

    Returns:
        (C,) names such as `video`, `cam1/video`, `video.mp4`, or `C1_video` where neither folders
        nor suffixes tell the files apart.

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
    for kept in (bare, places):
        for depth in range(1, DEEPEST + 1):
            names = ["/".join(_parts(place)[-depth:]) for place in kept]
            if all(names) and len(set(names)) == len(names):
                return names
    return [f"C{camera + 1}_{place.name}" for camera, place in enumerate(bare)]


def _parts(place: Path) -> tuple[str, ...]:
    """List folders and file below the root; bytes that are not UTF-8 become question marks."""
    below = place.parts[1:] if place.anchor else place.parts
    return tuple(part.encode("utf-8", "replace").decode() for part in below)


def file_names(names: Sequence[str]) -> list[str]:
    """Make distinct file names for one folder, one per camera.

    Args:
        names: (C,) camera names, which may be parts of paths.

    Returns:
        (C,) the names with `_` in place of folder separators, cut to the length that file systems
        allow, and made distinct by `distinct_names`.
    """
    plain = ("".join("_" if c in "/\\:\0" else c for c in name) for name in names)
    return distinct_names([_fitting(name.lstrip(".")) for name in plain])


def _fitting(name: str) -> str:
    """Cut a name so that file systems have room for suffix and number."""
    return name.encode("utf-8", "replace")[:LONGEST].decode("utf-8", "ignore")


def distinct_names(names: Sequence[str]) -> list[str]:
    """Make names distinct on any file system.

    An empty or repeated name gets the number of its camera.

    Args:
        names: (C,) names that were made from distinct ones.
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
