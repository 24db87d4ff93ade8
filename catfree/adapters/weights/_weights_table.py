"""The published ONNX files that are known by name.

A file is listed if its license permits any use, an adapter runs it, and a publisher states its
SHA-256. OpenCV's model zoo does, for the files that it stores with Git LFS; its copy of YOLOX-S is
the file of YOLOX's own release.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from catfree.errors import InvalidInputError, quoted

_YOLOX_RELEASE = "https://github.com/Megvii-BaseDetection/YOLOX/releases/download/0.1.1rc0"
_OPENCV_ZOO = "https://github.com/opencv/opencv_zoo"
_ZOO_COMMIT = "953d93cef45b6532d5fcdced815e6b5dae898d93"
_ZOO_REID = "models/person_reid_youtureid"


@dataclass(frozen=True)
class Weights:
    """A published ONNX file.

    Attributes:
        name: its name for `pretrained` and the command line.
        task: the adapter's role: detector or embedder.
        description: the network in a few words.
        license: SPDX identifier of the license under which the weights are published.
        url: address of the file.
        page: page of the publisher, with the license.
        sha256: SHA-256 of the file in hexadecimal digits.
        size: size of the file in bytes.
    """

    name: str
    task: Literal["detector", "embedder"]
    description: str
    license: str
    url: str
    page: str
    sha256: str
    size: int

    @property
    def file_name(self) -> str:
        """Name of the file, the last part of its address."""
        return self.url.rpartition("/")[2]


_LISTED = (
    Weights(
        "yolox-s",
        "detector",
        "YOLOX-S detector, 640 x 640",
        "Apache-2.0",
        f"{_YOLOX_RELEASE}/yolox_s.onnx",
        "https://github.com/Megvii-BaseDetection/YOLOX",
        "c5c2d13e59ae883e6af3b45daea64af4833a4951c92d116ec270d9ddbe998063",
        35_858_002,
    ),
    Weights(
        "youtu-reid",
        "embedder",
        "Tencent Youtu re-identification",
        "Apache-2.0",
        f"{_OPENCV_ZOO}/raw/{_ZOO_COMMIT}/{_ZOO_REID}/person_reid_youtu_2021nov.onnx",
        f"{_OPENCV_ZOO}/tree/{_ZOO_COMMIT}/{_ZOO_REID}",
        "0579683334d4b9440221606dcb461656dd0dc64143b18f48faedaced9b4f580d",
        106_878_407,
    ),
)

WEIGHTS: Mapping[str, Weights] = MappingProxyType({weights.name: weights for weights in _LISTED})


def weights_named(name: str) -> Weights:
    """Look a file up.

    Raises:
        InvalidInputError: if no file has the name.
    """
    if not isinstance(name, str) or name not in WEIGHTS:
        raise InvalidInputError(
            f"There are no weights named {quoted(name)}; known are {', '.join(WEIGHTS)}. Give "
            "other files to the adapters by path."
        )
    return WEIGHTS[name]
