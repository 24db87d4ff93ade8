"""Lengths to which arrays are padded, so that the next sequence finds its code compiled."""

SHORT = 2**15  # rows: computing twice as many takes less than the second that compiling takes


def coarse_length(count: int, block: int, factor: int = 4) -> int:
    """The smallest of block, block · factor, block · factor², ... that holds `count`.

    For stages whose cost hardly depends on the padding: the fewest compilations.

    Args:
        count: rows to hold.
        block: the shortest length.
        factor: ratio of successive lengths.

    Returns:
        The padded length.
    """
    length = block
    while length < count:
        length *= factor
    return length


def fine_length(count: int, minimum: int = 64) -> int:
    """The smallest of few lengths that holds `count`: doubling ones, then four an octave.

    For stages whose cost grows with the padding. Short arrays are computed faster than code for
    another length is compiled; of long ones at most a quarter is wasted.

    Args:
        count: rows to hold.
        minimum: the shortest length.

    Returns:
        The padded length.
    """
    length = minimum
    while length < count:
        short = length < SHORT
        length += length if short else 1 << max(length.bit_length() - 3, 0)
    return length
