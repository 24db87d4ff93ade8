"""Boxes in the JSON of COCO: results of a detector, and data sets with annotations."""

import re
from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from catfree.adapters.files._camera_names import natural_order
from catfree.adapters.files._documents import (
    StrPath,
    entry,
    is_whole,
    list_of,
    naming_file,
    numbers,
    numbers_of,
    read_json,
)
from catfree.errors import FileFormatError, InvalidInputError, quoted, shortened
from catfree.types import Detections

PERSON = 1  # COCO's category of people
_DIGITS = re.compile(r"\d+")
_MOST_DIGITS = 30  # of a frame number, leading zeros included


class CocoBoxes(NamedTuple):
    """Boxes of people in COCO's form.

    Attributes:
        detections: boxes of all cameras.
        camera_names: (C,) folders of the images, or None if the images have none.
        image_size: (C, 2) width and height in pixels, or None if not stated for all.
    """

    detections: Detections
    camera_names: tuple[str, ...] | None
    image_size: np.ndarray | None


class _Image(NamedTuple):
    camera: str
    frame: int
    name: str | int


def read_coco(path: StrPath, images: StrPath | None = None) -> CocoBoxes:
    """Read the people in COCO results, a list of `{image_id, category_id, bbox, score}`.

    Data sets, objects with `images` and `annotations`, are read, too. The camera of an image is
    the folder of its `file_name`, and the frame the last number in it: `C1/000005.png`. Without a
    data set, the `image_id` of a result is a file name, or a whole number: the frame of a single
    camera. Boxes around groups, `"iscrowd": 1`, are left out.

    Args:
        path: the results, or the data set with annotations.
        images: the data set that describes the images of the results.

    Returns:
        Boxes, names of cameras and sizes of images.

    Raises:
        InvalidInputError: if there is no such file, or a box has no area or a score is invalid.
        FileFormatError: naming the first entry that has another form or an unknown image, the first
            image that shares its id, or camera and frame, with another or differs in size from the
            camera's first, or if no box is of a person.
    """
    document = read_json(path, "boxes in COCO's form")
    described = document if isinstance(document, dict) else None
    images_by_id, sizes = None, {}
    if images is not None:
        described = read_json(images, "images in COCO's form")
    if described is not None:
        with naming_file(images or path):
            images_by_id, sizes = _images(described)
    with naming_file(path):
        rows = entry(document, "annotations") if isinstance(document, dict) else document
        rows = list_of(rows, "the boxes in COCO's form")
        return _boxes(rows, images_by_id, sizes, _people(described))


def _boxes(
    rows: list[Any],
    images_by_id: dict[Any, _Image] | None,
    sizes: dict[str, tuple[int, int]],
    categories: Sequence[Any],
) -> CocoBoxes:
    """Take the boxes of people; without a data set, the boxes name their images."""
    frame, camera, corners, score = [], [], [], []
    first_of: dict[tuple[str, int], _Image] = {}
    others = []
    for at, row in enumerate(rows):
        where = f"box {at}"
        category = row.get("category_id", PERSON) if isinstance(row, dict) else PERSON
        if category not in categories:
            others.append(str(category))
            continue
        name = entry(row, "image_id", where)
        if row.get("iscrowd"):
            continue
        image = None
        if isinstance(name, int | str):
            image = _image_of(name) if images_by_id is None else images_by_id.get(name)
        if image is None:
            raise FileFormatError(
                f"{where} is of the image {quoted(name)}, which is not listed, so its frame is "
                "unknown."
            )
        if images_by_id is None:
            _require_own_place(first_of, image)
        box = numbers_of(row, "bbox", (4,), where)
        if not (box[2:] > 0).all():
            raise InvalidInputError(
                f"{where} is {box.tolist()} as left, top, width, height, which has no area. "
                "Correct or remove it."
            )
        frame.append(image.frame)
        camera.append(image.camera)
        corners.append(np.concatenate([box[:2], box[:2] + box[2:]]))
        if "score" in row:
            score.append(float(numbers(row["score"], (), f"score of {where}")))
    if others and not frame:
        raise FileFormatError(
            f"no box is of a person, whose category_id is {' or '.join(map(str, categories))}; the "
            f"boxes have {shortened(', '.join(sorted(set(others), key=natural_order)))}. Correct "
            "that of the people, or give the data set that names the categories, too."
        )
    if score and len(score) < len(frame):
        raise FileFormatError("some boxes have a score, but not all.")
    listed = {image.camera for image in (images_by_id or {}).values()}
    ordered = sorted({*listed, *camera}, key=natural_order)
    index = {name: at for at, name in enumerate(ordered)}
    detections = Detections(
        np.array(frame, np.int64),
        np.array([index[name] for name in camera], np.int64),
        np.array(corners).reshape(-1, 4),
        np.array(score) if score else None,
    )
    stated = [sizes.get(name) for name in ordered]
    size = np.array(stated, np.int64) if stated and all(stated) else None
    return CocoBoxes(detections, None if set(ordered) <= {""} else tuple(ordered), size)


def is_coco(document: Any) -> bool:
    """Return whether a parsed JSON document is a list of boxes or a data set of COCO."""
    if isinstance(document, dict):
        return "images" in document
    return isinstance(document, list) and (
        not document or (isinstance(document[0], dict) and "bbox" in document[0])
    )


def _people(document: dict[str, Any] | None) -> Sequence[Any]:
    """Return the categories named person or pedestrian, or else COCO's."""
    categories = (document or {}).get("categories")
    if not isinstance(categories, list):
        return (PERSON,)
    people = [
        one.get("id")
        for one in categories
        if isinstance(one, dict)
        and str(one.get("name")).lower() in ("person", "people", "pedestrian")
    ]
    return people or (PERSON,)


def _images(document: Any) -> tuple[dict[Any, _Image], dict[str, tuple[int, int]]]:
    """Read the images by id, and the size of each camera whose images state one."""
    images_by_id: dict[Any, _Image] = {}
    first_of: dict[tuple[str, int], _Image] = {}
    sizes: dict[str, tuple[int, int]] = {}
    for at, row in enumerate(list_of(entry(document, "images"), "images")):
        where = f"image {at}"
        name = entry(row, "file_name", where)
        image = _image_of(name) if isinstance(name, str) else None
        if image is None:
            raise FileFormatError(f"the file name of {where}, {quoted(name)}, has no frame number.")
        _require_own_place(first_of, image)
        if "width" in row and "height" in row:
            pair = [row["width"], row["height"]]
            if not all(is_whole(value) and value > 0 for value in pair):
                raise FileFormatError(
                    f"the size of {where} is {quoted(pair)}, not two whole numbers."
                )
            size = (int(pair[0]), int(pair[1]))
            first = sizes.setdefault(image.camera, size)
            if size != first:
                raise FileFormatError(
                    f"{where} ({quoted(name)}) is {size[0]} x {size[1]} px, but the camera started "
                    f"with {first[0]} x {first[1]} px. Scale its images and boxes to one size."
                )
        key = entry(row, "id", where)
        if not isinstance(key, int | str):
            raise FileFormatError(f"the id of {where} is {quoted(key)}.")
        other = images_by_id.setdefault(key, image)
        if other[:2] != image[:2]:
            raise FileFormatError(
                f"the images {quoted(other.name)} and {quoted(name)} have the same id, "
                f"{quoted(key)}, so boxes of it could be of either. Give each image its own id."
            )
    return images_by_id, sizes


def _require_own_place(first_of: dict[tuple[str, int], _Image], image: _Image) -> None:
    """Record the image of a camera and frame; raise if another one has both."""
    first = first_of.setdefault((image.camera, image.frame), image)
    if first.name != image.name:
        raise FileFormatError(
            f"the images {quoted(first.name)} and {quoted(image.name)} would be one picture, frame "
            f"{image.frame} of one camera. Put the images of each camera into a folder of its own."
        )


def _image_of(name: Any) -> _Image | None:
    """Take camera and frame from a file name, or the frame alone from a whole number."""
    if is_whole(name):
        return _Image("", int(name), name)
    if not isinstance(name, str):
        return None
    path = PurePosixPath(name)
    digits = _DIGITS.findall(path.stem)
    if not digits or len(digits[-1]) > _MOST_DIGITS or not is_whole(int(digits[-1])):
        return None
    camera = "" if str(path.parent) == "." else str(path.parent)
    return _Image(camera, int(digits[-1]), name)
