"""What cameras are called: after their files, told apart, and fit to name files in turn."""

import os
from collections.abc import Sequence
from pathlib import Path

from catfree.errors import InvalidInputError

# More folders than these before the file would be a path, not a name.
DEEPEST = 3
# Bytes of a file's name before its suffix; file systems hold 255 in all.
LONGEST = 200


def require_readable_name(path: Path) -> None:
    """Raise if a path is no text: OpenCV cannot open it, and no result could name its camera.

    Raises:
        InvalidInputError: showing the path with its bytes escaped.
    """
    if not is_text(str(path)):
        raise InvalidInputError(
            f"The path {str(path)!a} is not valid UTF-8, so it cannot be opened as a video or "
            "named in a result. Rename it."
        )


def is_text(name: str) -> bool:
    """Whether a name can be written as UTF-8: bytes of another encoding in a path cannot."""
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def names_of_files(paths: Sequence[Path]) -> list[str]:
    """One name a camera, no two alike: the file's, with folders or suffix where that is not enough.

    Args:
        paths: (C,) files or image folders.

    Returns:
        (C,) names such as `video`, `cam1/video`, `video.mp4`, or `C1_video` where neither folders
        nor suffixes tell the files apart.

    Raises:
        InvalidInputError: if two paths lead to the same file or folder.
    """
    seen: dict[Path, int] = {}
    for camera, path in enumerate(paths):
        first = seen.setdefault(path.resolve(), camera)
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
    """Folders and file below the root; bytes that are no text become question marks."""
    below = place.parts[1:] if place.anchor else place.parts
    return tuple(part.encode("utf-8", "replace").decode() for part in below)


def file_names(names: Sequence[str]) -> list[str]:
    """Names of files that lie in one folder, one a camera.

    Args:
        names: (C,) camera names, which may be parts of paths.

    Returns:
        (C,) the names with `_` for what separates folders, cut to what file systems hold, and
        distinct as `distinct_names` makes them.
    """
    plain = ("".join("_" if c in "/\\:\0" else c for c in name) for name in names)
    return distinct_names([_fitting(name.lstrip(".")) for name in plain])


def _fitting(name: str) -> str:
    """The beginning of a name that leaves a file system room for suffix and number."""
    return name.encode("utf-8", "replace")[:LONGEST].decode("utf-8", "ignore")


def distinct_names(names: Sequence[str]) -> list[str]:
    """The names, no two alike on any file system.

    An empty or repeated one gets the number of its camera.

    Args:
        names: (C,) names that were made from distinct ones.
    """
    taken = {name.casefold() for name in names}
    seen, given = {""}, []
    for camera, name in enumerate(names):
        label = name
        while label.casefold() in seen or (label != name and label.casefold() in taken):
            label = f"{label}_C{camera + 1}"
        seen.add(label.casefold())
        given.append(label)
    return given
