"""Published weights: fetching, checking, keeping and refusing, with a server on this machine."""

import dataclasses
import gc
import hashlib
import http.server
import inspect
import os
import sys
import threading
import warnings
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pooch
import pytest

from catfree.adapters import WEIGHTS, ReIdOnnx, Weights, YoloxOnnx, fetch_weights, pretrained
from catfree.adapters.weights import _weights_table
from catfree.cli import main
from catfree.cli._inputs import open_detector, open_embedder, require_files
from catfree.errors import (
    DownloadError,
    FileFormatError,
    InvalidInputError,
    MissingDependencyError,
    WriteError,
)


class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.server.asked.append(self.path)
        content = self.server.files.get(self.path)
        if content is None:
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        # The connection ends here, whether or not that is the end of the file.
        self.wfile.write(content[: self.server.cut_after])

    def log_message(self, *_):
        pass


@pytest.fixture
def server():
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as running:
        running.files, running.asked, running.cut_after = {}, [], None
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield running
        running.shutdown()
        thread.join()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("CATFREE_WEIGHTS", str(tmp_path / "kept" / "weights"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    return tmp_path / "kept" / "weights"


@pytest.fixture
def published(server, folder, monkeypatch, constant_graph):
    """Put two networks on the server, under the names of a table."""
    head = np.zeros((84, 85))  # a YOLOX head of 64 x 64 pixels that sees one person
    head[0, :6] = [2, 4, np.log(2), np.log(4), 1, 1]
    graphs = {
        "eyes": ("detector", constant_graph([1, 3, 64, 64], {"o": head}, name="eyes.onnx")),
        "looks": (
            "embedder",
            constant_graph([1, 3, 256, 128], {"o": np.array([3.0, 4])}, name="looks.onnx"),
        ),
    }
    table = {}
    address = f"http://127.0.0.1:{server.server_address[1]}"
    for name, (task, path) in graphs.items():
        content = path.read_bytes()
        server.files[f"/{path.name}"] = content
        digest = hashlib.sha256(content).hexdigest()
        url = f"{address}/{path.name}"
        table[name] = Weights(name, task, "a graph", "CC0-1.0", url, url, digest, len(content))
    replace_table(monkeypatch, table)
    return table


def replace_table(monkeypatch, table):
    monkeypatch.setattr(_weights_table, "WEIGHTS", MappingProxyType(table))


def leftovers(folder):
    return sorted(path.name for path in folder.rglob("*") if path.is_file())


def test_a_file_is_fetched_once_checked_and_kept(published, server, folder, capfd):
    steps = []
    path = fetch_weights("eyes", progress=lambda *step: steps.append(step))
    assert path == folder / "eyes.onnx"
    assert path.read_bytes() == server.files["/eyes.onnx"]
    size = published["eyes"].size
    assert steps[-1] == ("weights", size, size)
    assert [done for _, done, _ in steps] == sorted(done for _, done, _ in steps)
    assert fetch_weights("eyes") == fetch_weights("eyes", download=False) == path
    assert server.asked == ["/eyes.onnx"]
    assert leftovers(folder) == ["eyes.onnx"]
    other = folder / "other"
    other.touch()
    assert path.stat().st_mode == other.stat().st_mode, "whoever may read the folder may read it"
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_names_become_adapters(published):
    eyes, looks = pretrained("eyes", confidence=0.5), pretrained("looks")
    assert isinstance(eyes, YoloxOnnx)
    assert isinstance(looks, ReIdOnnx)
    people = eyes(np.zeros((64, 64, 3), np.uint8))
    np.testing.assert_allclose(people.box, [[8, 16, 24, 48]], atol=1e-4)
    np.testing.assert_allclose(looks(np.zeros((64, 64, 3), np.uint8), people.box), [[0.6, 0.8]])
    with pytest.raises(InvalidInputError, match="confidence"):
        pretrained("eyes", confidence=2)


def test_nothing_is_fetched_unless_asked(published, server, folder):
    with pytest.raises(InvalidInputError, match="catfree weights get eyes") as refused:
        pretrained("eyes", download=False)
    assert published["eyes"].url in str(refused.value)
    assert str(folder / "eyes.onnx") in str(refused.value)
    assert server.asked == []
    assert not folder.exists()
    folder.mkdir(parents=True)
    (folder / "eyes.onnx").write_bytes(server.files["/eyes.onnx"])  # put there by hand
    assert pretrained("eyes", download=False).fingerprint == pretrained("eyes").fingerprint
    assert server.asked == []


def test_a_damaged_copy_is_refused_or_fetched_again(published, server, folder):
    folder.mkdir(parents=True)
    (folder / "eyes.onnx").write_bytes(b"half")
    with pytest.raises(InvalidInputError, match="is not the published file"):
        fetch_weights("eyes", download=False)
    assert fetch_weights("eyes").read_bytes() == server.files["/eyes.onnx"]


def test_another_file_than_the_published_one_is_not_kept(published, server, folder):
    server.files["/eyes.onnx"] += b"!"
    with pytest.raises(DownloadError, match="not the published file"):
        fetch_weights("eyes")
    assert leftovers(folder) == []


@pytest.mark.slow
@pytest.mark.parametrize("failure", ["cut", "missing", "refused"])
def test_failures_say_what_to_fetch_by_hand(failure, published, server, folder, monkeypatch):
    if failure == "cut":
        server.cut_after = 100
    elif failure == "missing":
        server.files.clear()
    else:
        url = "http://127.0.0.1:9/eyes.onnx"  # a port without a service
        replace_table(monkeypatch, {"eyes": dataclasses.replace(published["eyes"], url=url)})
    with pytest.raises(DownloadError) as failed:
        fetch_weights("eyes")
    sentence = str(failed.value)
    assert failed.value.__cause__ is not failed.value
    del failed
    with warnings.catch_warnings(action="ignore", category=ResourceWarning):
        gc.collect()  # pooch leaves a broken connection to the garbage collector
    assert f"fetch {_weights_table.WEIGHTS['eyes'].url} by hand" in sentence
    assert str(folder / "eyes.onnx") in sentence
    assert "\n" not in sentence
    assert leftovers(folder) == []


def test_a_folder_that_cannot_be_made_is_named(published, folder, server):
    folder.parent.write_text("a file where the folder should be")
    with pytest.raises(WriteError, match="weights"):
        fetch_weights("eyes")
    assert server.asked == []


def test_unknown_names_list_the_known_ones():
    with pytest.raises(InvalidInputError, match=r"'yolo-z'; known are yolox-s, youtu-reid"):
        pretrained("yolo-z")


def test_a_name_is_text():
    unchecked = inspect.unwrap(_weights_table.weights_named)
    with pytest.raises(InvalidInputError, match=r"There are no weights named \['yolox-s'\]"):
        unchecked(["yolox-s"])


def test_without_pooch_the_extra_is_named(monkeypatch):
    monkeypatch.delenv("CATFREE_WEIGHTS", raising=False)
    monkeypatch.setitem(sys.modules, "pooch", None)
    with pytest.raises(MissingDependencyError, match=r"catfree\[weights\]"):
        fetch_weights("yolox-s")


def test_without_a_variable_files_are_in_the_users_cache(monkeypatch, tmp_path):
    monkeypatch.delenv("CATFREE_WEIGHTS", raising=False)
    if os.name == "posix" and sys.platform != "darwin":
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(InvalidInputError, match="not on this machine") as refused:
        fetch_weights("youtu-reid", download=False)
    assert str(pooch.os_cache("catfree")) in str(refused.value)


def test_the_table_is_complete():
    for name, weights in WEIGHTS.items():
        assert weights.name == name
        assert weights.url.startswith("https://")
        assert weights.page.startswith("https://")
        assert weights.file_name.endswith(".onnx")
        assert len(bytes.fromhex(weights.sha256)) == 32
        assert weights.size > 1e6
        assert weights.license in ("Apache-2.0", "MIT", "BSD-3-Clause")


@pytest.mark.slow
def test_the_commands_list_get_and_use_names(published, folder, capsys, tmp_path):
    pytest.importorskip("tyro")
    assert main(["weights", "list"]) == 0
    listed = capsys.readouterr().out
    for weights in published.values():
        assert weights.url in listed
        assert weights.sha256 in listed
    assert str(folder) in listed
    videos = (tmp_path, tmp_path)
    named = Path("eyes")
    with pytest.raises(InvalidInputError, match="catfree weights get eyes"):
        require_files(videos, detector=named)
    assert main(["weights", "get", "eyes", "looks"]) == 0
    assert capsys.readouterr().out.split() == [str(folder / f"{n}.onnx") for n in published]
    require_files(videos, detector=named)
    assert isinstance(open_detector(named), YoloxOnnx)
    assert isinstance(open_embedder(named.with_name("looks")), ReIdOnnx)
    with pytest.raises(FileFormatError):
        open_embedder(named)
    assert main(["weights", "get"]) == 1
    assert "weights list" in capsys.readouterr().err
