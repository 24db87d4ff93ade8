"""`read_toml` rejects documents that are too long, too deep or not TOML, and says which."""

import json

import pytest
from hypothesis import given, strategies as st

from catfree.adapters.files._toml import read_toml
from catfree.errors import FileFormatError, InvalidInputError

keys = st.text(st.characters(codec="ascii", categories=["L"]), min_size=1)
texts = st.text(st.characters(codec="ascii", exclude_categories=["Cc"]))


@given(st.dictionaries(keys, texts | st.integers(-(10**9), 10**9) | st.floats(-1e9, 1e9)))
def test_a_document_comes_back(tmp_path_factory, document):
    path = tmp_path_factory.mktemp("toml") / "a.toml"
    path.write_text("\n".join(f"{key} = {json.dumps(value)}" for key, value in document.items()))
    assert read_toml(path, "list", largest=10**6, dots=1) == document


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = 1" + " " * 100, r"a\.toml has 105 characters; a list has at most 100"),
        ("a = 1\nb.c.d.e.f = 1", r"a\.toml: line 2 has 4 dots; a list has at most 3 per line"),
        ("a = ", r"a\.toml is not valid TOML"),
    ],
)
def test_mistakes_are_named(tmp_path, text, said):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=said):
        read_toml(path, "list", largest=100, dots=3)
    with pytest.raises(InvalidInputError, match="There is no file"):
        read_toml(tmp_path / "b.toml", "list", largest=100, dots=3)


def test_texts_may_have_dots(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("a = '.......'\nb = \"........\"  # two")
    assert read_toml(path, "list", largest=100, dots=0) == {"a": "." * 7, "b": "." * 8}
