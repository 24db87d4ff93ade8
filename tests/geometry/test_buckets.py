"""Padded lengths: long enough, never longer than promised, and few."""

from hypothesis import given, strategies as st

from catfree.geometry.buckets import SHORT, coarse_length, fine_length

counts = st.integers(0, 10**6)
blocks = st.integers(1, 10**4)


@given(counts, blocks, st.integers(2, 4))
def test_coarse_lengths_are_powers_times_the_block(count, block, factor):
    length = coarse_length(count, block, factor)
    assert length >= count
    assert length == block or length < factor * count
    while length > block:
        length, rest = divmod(length, factor)
        assert rest == 0
    assert length == block


@given(counts, st.integers(1, 512))
def test_fine_lengths_waste_at_most_a_quarter_of_long_arrays(count, minimum):
    length = fine_length(count, minimum)
    assert count <= length
    assert length <= max(minimum, 2 * count, 1)
    if count > 2 * SHORT:
        assert length <= 1.27 * count + 1


@given(st.integers(1, SHORT), st.integers(0, 6))
def test_short_lengths_double(count, power):
    length = fine_length(count, 2**power)
    assert length.bit_count() == 1


@given(counts, counts)
def test_longer_arrays_never_get_shorter_lengths(count, other):
    low, high = sorted((count, other))
    assert fine_length(low) <= fine_length(high)
    assert coarse_length(low, 64) <= coarse_length(high, 64)


def test_few_lengths_serve_a_million_rows():
    assert len({fine_length(count) for count in range(1, 10**6, 37)}) <= 60
    assert {coarse_length(count, 16384) for count in range(1, 10**6, 37)} == {
        16384 * 4**power for power in range(4)
    }
