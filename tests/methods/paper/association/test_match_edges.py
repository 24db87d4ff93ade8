"""One-to-one matching against exhaustive search, and chains of links."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from catfree.methods.paper.association._match_edges import chain_labels, match_edges

COST = st.floats(-1, 3).map(lambda x: round(x, 2))
EDGES = st.lists(
    st.tuples(st.integers(0, 1), st.integers(0, 3), st.integers(0, 3), COST),
    max_size=12,
    unique_by=lambda edge: edge[:3],
)


def matchings(edges):
    """Yield all choices of edges that use no source and no target twice."""
    for size in range(len(edges) + 1):
        for chosen in itertools.combinations(range(len(edges)), size):
            sources = [edges[i][0:2] for i in chosen]
            targets = [(edges[i][0], edges[i][2]) for i in chosen]
            if len(set(sources)) == len(sources) and len(set(targets)) == len(targets):
                yield chosen


def columns(edges):
    """Sources and targets of different problems are different elements."""
    problem, source, target = np.array([edge[:3] for edge in edges], int).reshape(-1, 3).T
    cost = np.array([edge[3] for edge in edges], float)
    return problem, source + 10 * problem, target + 10 * problem, cost


@pytest.mark.slow
@settings(max_examples=60)
@given(EDGES)
def test_as_many_as_possible_then_the_smallest_cost(edges):
    chosen = np.flatnonzero(match_edges(*columns(edges)))
    assert tuple(chosen) in set(matchings(edges))
    cost = columns(edges)[3]
    best = min(((-len(some), sum(cost[list(some)])) for some in matchings(edges)), default=(0, 0.0))
    assert len(chosen) == -best[0]
    np.testing.assert_allclose(cost[chosen].sum(), best[1], atol=1e-9)


@given(st.lists(st.integers(1, 6), max_size=6), st.randoms())
def test_chains_are_labelled_in_order_of_their_lowest_elements(lengths, random):
    places = list(range(sum(lengths)))
    random.shuffle(places)
    predecessor = np.full(len(places), -1)
    wanted = np.zeros(len(places), int)
    chains, begin = [], 0
    for length in lengths:
        chains.append(places[begin : begin + length])
        begin += length
    for number, chain in enumerate(sorted(chains, key=min)):
        wanted[chain] = number
        predecessor[chain[1:]] = chain[:-1]
    np.testing.assert_array_equal(chain_labels(predecessor), wanted)
