"""Small ONNX graphs, made for each test with exactly the contract that it needs."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

OnnxWriter = Callable[..., Path]


def save_graph(
    path: Path,
    nodes: Sequence[onnx.NodeProto],
    constants: Mapping[str, np.ndarray],
    inputs: Mapping[str, Sequence[int | str]],
    outputs: Mapping[str, Sequence[int | str]],
    *,
    metadata: Mapping[str, str] | None = None,
    producer: str = "pytorch",
    element: int = TensorProto.FLOAT,
) -> Path:
    graph = helper.make_graph(
        list(nodes),
        "graph",
        [helper.make_tensor_value_info(n, element, list(s)) for n, s in inputs.items()],
        [helper.make_tensor_value_info(n, element, list(s)) for n, s in outputs.items()],
        [numpy_helper.from_array(np.asarray(v), n) for n, v in constants.items()],
    )
    model = helper.make_model(
        graph, producer_name=producer, opset_imports=[helper.make_opsetid("", 17)], ir_version=8
    )
    helper.set_model_props(model, dict(metadata or {}))
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return path


@pytest.fixture
def constant_graph(tmp_path) -> OnnxWriter:
    """Write a graph that answers every input with the same values, repeated over open axes.

    `answers` maps each output's name to its value without `lead` leading axes, which are as long as
    the input's.
    """

    def write(
        input_shape: Sequence[int | str],
        answers: Mapping[str, np.ndarray],
        *,
        lead: int = 1,
        name: str = "graph.onnx",
        input_name: str = "images",
        half: bool = False,
        open_outputs: bool = False,
        **options,
    ) -> Path:
        width = np.float16 if half else np.float32
        nodes = [
            helper.make_node("Shape", [input_name], ["lead"], start=0, end=lead),
        ]
        constants, outputs = {}, {}
        for key, value in answers.items():
            constants[f"{key}_value"] = value.astype(width)
            constants[f"{key}_tail"] = np.array(value.shape, np.int64)
            nodes += [
                helper.make_node("Concat", ["lead", f"{key}_tail"], [f"{key}_shape"], axis=0),
                helper.make_node("Expand", [f"{key}_value", f"{key}_shape"], [key]),
            ]
            tail = [f"{key}_{i}" for i in range(value.ndim)] if open_outputs else value.shape
            outputs[key] = [*input_shape[:lead], *tail]
        element = TensorProto.FLOAT16 if half else TensorProto.FLOAT
        return save_graph(
            tmp_path / name,
            nodes,
            constants,
            {input_name: input_shape},
            outputs,
            element=element,
            **options,
        )

    return write


@pytest.fixture
def red_finder(tmp_path) -> OnnxWriter:
    """Write a one-class YOLO pose graph that boxes the red pixels of its input.

    All 17 keypoints lie at the box's lower right corner. The answer shows where a picture's content
    really is in the input.
    """

    def write(width: int, height: int, *, batch: int | str = 1) -> Path:
        names = ["low_x", "high_x", "low_y", "high_y"]
        constants = {
            "bright": np.array(0.6, np.float32),
            "dark": np.array(0.4, np.float32),
            "half": np.array(0.5, np.float32),
            "red": np.array([0], np.int64),
            "green": np.array([1], np.int64),
            "blue": np.array([2], np.int64),
            "channel": np.array([1], np.int64),
            "columns_up": np.arange(1, width + 1, dtype=np.float32),
            "columns_down": np.arange(width, 0, -1, dtype=np.float32),
            "rows_up": np.arange(1, height + 1, dtype=np.float32),
            "rows_down": np.arange(height, 0, -1, dtype=np.float32),
            "width": np.array(width, np.float32),
            "height": np.array(height, np.float32),
            "zero": np.array(0, np.float32),
            "score": np.array(0.9, np.float32),
            "last": np.array([-1], np.int64),
            "repeats": np.array([1, 17, 1], np.int64),
        }
        node = helper.make_node
        nodes = [
            node("Gather", ["images", "red"], ["r"], axis=1),
            node("Gather", ["images", "green"], ["g"], axis=1),
            node("Greater", ["r", "bright"], ["is_red"]),
            node("Less", ["g", "dark"], ["not_white"]),
            node("And", ["is_red", "not_white"], ["mask"]),
            node("Cast", ["mask"], ["value"], to=TensorProto.FLOAT),
            node("ReduceMax", ["value"], ["by_column"], axes=[1, 2], keepdims=0),
            node("ReduceMax", ["value"], ["by_row"], axes=[1, 3], keepdims=0),
        ]
        for axis, source, extent in (
            ("columns", "by_column", "width"),
            ("rows", "by_row", "height"),
        ):
            letter = "x" if axis == "columns" else "y"
            nodes += [
                node("Mul", [source, f"{axis}_up"], [f"{axis}_1"]),
                node("ReduceMax", [f"{axis}_1"], [f"high_{letter}"], axes=[1], keepdims=1),
                node("Mul", [source, f"{axis}_down"], [f"{axis}_2"]),
                node("ReduceMax", [f"{axis}_2"], [f"span_{letter}"], axes=[1], keepdims=1),
                node("Sub", [extent, f"span_{letter}"], [f"low_{letter}"]),
                node("Add", [f"low_{letter}", f"high_{letter}"], [f"sum_{letter}"]),
                node("Mul", [f"sum_{letter}", "half"], [f"centre_{letter}"]),
                node("Sub", [f"high_{letter}", f"low_{letter}"], [f"size_{letter}"]),
            ]
        nodes += [
            node("ReduceMax", ["by_column"], ["any"], axes=[1], keepdims=1),
            node("Mul", ["any", "score"], ["confidence"]),
            node("Concat", ["high_x", "high_y", "confidence"], ["point"], axis=1),
            node("Unsqueeze", ["point", "channel"], ["points"]),
            node("Tile", ["points", "repeats"], ["tiled"]),
            node("Flatten", ["tiled"], ["keypoints"], axis=1),
            node(
                "Concat",
                ["centre_x", "centre_y", "size_x", "size_y", "confidence", "keypoints"],
                ["row"],
                axis=1,
            ),
            node("Unsqueeze", ["row", "last"], ["output0"]),
        ]
        used = {name for n in nodes for name in n.input}
        assert set(names) <= {name for n in nodes for name in n.output}
        return save_graph(
            tmp_path / f"red_{width}x{height}.onnx",
            nodes,
            {k: v for k, v in constants.items() if k in used},
            {"images": [batch, 3, height, width]},
            {"output0": [batch, 56, 1]},
        )

    return write
