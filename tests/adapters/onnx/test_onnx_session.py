import builtins

import numpy as np
import pytest

from catfree.adapters.onnx._onnx_batching import run_batched
from catfree.adapters.onnx._onnx_session import OnnxGraph
from catfree.errors import (
    CatFreeError,
    FileFormatError,
    InvalidInputError,
    MissingDependencyError,
)


def open_graph(path, **options):
    return OnnxGraph(path, needed="a test graph", **options)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InvalidInputError, match=r"no file .*absent\.onnx; a test graph is needed"):
        open_graph(tmp_path / "absent.onnx")


@pytest.mark.parametrize("content", [b"", b"not a graph at all", b"\x08\x08\x12\x07pytorch" * 40])
def test_a_file_that_is_no_graph_gives_one_sentence(tmp_path, content):
    path = tmp_path / "broken.onnx"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=r"broken\.onnx .*a test graph is needed") as caught:
        open_graph(path)
    assert "\n" not in str(caught.value)


def test_a_truncated_graph_gives_one_sentence(tmp_path, constant_graph):
    whole = constant_graph([1, 3, 8, 8], {"out": np.zeros((4, 5), np.float32)}).read_bytes()
    path = tmp_path / "half.onnx"
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileFormatError, match=r"half\.onnx"):
        open_graph(path)


def test_an_unknown_provider_is_named(constant_graph):
    path = constant_graph([1, 3, 8, 8], {"out": np.zeros(4, np.float32)})
    with pytest.raises(InvalidInputError, match="NoSuchProvider"):
        open_graph(path, providers=["NoSuchProvider"])
    assert open_graph(path, providers=["CPUExecutionProvider"]).input_shape == (1, 3, 8, 8)


def test_wrong_input_axes_are_shown(constant_graph):
    graph = open_graph(constant_graph([1, 4, 8, "w"], {"out": np.zeros(4, np.float32)}))
    with pytest.raises(FileFormatError, match=r"'images' is \[1, 4, 8, \?\]"):
        graph.require_image_input(None)


def test_the_runtime_refusing_an_input_is_our_error(constant_graph):
    graph = open_graph(constant_graph([1, 3, 8, 8], {"out": np.zeros(4, np.float32)}))
    with pytest.raises(CatFreeError, match=r"could not be run on an input of shape \(1, 3, 9, 9\)"):
        graph.run(np.zeros((1, 3, 9, 9), np.float32))


def test_half_precision_in_and_float32_out(constant_graph):
    value = np.array([0.5, 2.0])
    graph = open_graph(constant_graph([1, 3, 4, 4], {"out": value}, half=True))
    out = graph.run(np.zeros((1, 3, 4, 4), np.float32))["out"]
    assert out.dtype == np.float32
    np.testing.assert_array_equal(out[0], value)


@pytest.mark.parametrize("batch", [1, 4, "batch"])
@pytest.mark.parametrize("count", [0, 1, 3, 4, 9])
def test_any_batch_axis_gives_one_row_an_item(constant_graph, batch, count):
    graph = open_graph(constant_graph([batch, 3, 2, 2], {"out": np.arange(5.0)}))
    rows = run_batched(graph, [np.zeros((3, 2, 2), np.float32)] * count, "out", 2)
    assert len(rows) == count
    for row in rows:
        np.testing.assert_array_equal(row, np.arange(5.0))


def test_the_content_hash_follows_the_bytes(constant_graph):
    first = open_graph(constant_graph([1, 3, 2, 2], {"out": np.zeros(2)}, name="a.onnx"))
    same = open_graph(constant_graph([1, 3, 2, 2], {"out": np.zeros(2)}, name="b.onnx"))
    other = open_graph(constant_graph([1, 3, 2, 2], {"out": np.ones(2)}, name="c.onnx"))
    assert first.content_hash == same.content_hash != other.content_hash


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ModuleNotFoundError("No module named 'onnxruntime'", name="onnxruntime"), "No module"),
        (ModuleNotFoundError("No module named 'flatbuffers'", name="flatbuffers"), "flatbuffers"),
        (ImportError("DLL load failed: too old"), "does not load: DLL load failed: too old"),
    ],
)
def test_the_reason_why_the_runtime_does_not_load_is_told(error, message, tmp_path, monkeypatch):
    load = builtins.__import__

    def broken(name, *rest):
        if name == "onnxruntime":
            raise error
        return load(name, *rest)

    (tmp_path / "a.onnx").touch()
    monkeypatch.setattr(builtins, "__import__", broken)
    with pytest.raises(MissingDependencyError, match=message) as raised:
        OnnxGraph(tmp_path / "a.onnx", needed="a test graph")
    assert raised.value.__cause__ is error
    assert "pip install onnxruntime" in str(raised.value)
