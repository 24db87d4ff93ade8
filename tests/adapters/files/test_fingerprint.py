"""Hashes of large sources change with any part that they sample."""

from hypothesis import given, strategies as st

from catfree.adapters.files._fingerprint import hash_samples


@given(st.integers(1, 80), st.data())
def test_the_files_of_a_folder_are_sampled_from_the_first_to_the_last(tmp_path_factory, n, data):
    folder = tmp_path_factory.mktemp("pictures")
    files = [folder / f"{number:03}.bin" for number in range(n)]
    for file in files:
        file.write_bytes(b"a")
    before = hash_samples(folder)
    begin = data.draw(st.integers(0, max(0, n - 1 - n // 15)))
    for file in files[begin : begin + n // 15 + 1]:
        file.write_bytes(b"b")
    assert hash_samples(folder) != before
