"""Give each person one identity over all shards of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from catfree._run._stitch import Fragments, Habits, add_habits, chains, link_fragments

Pairs = tuple[Int[np.ndarray, "..."], Int[np.ndarray, "..."]]  # of different lengths


@dataclass(frozen=True)
class ShardSummary:
    """What joining needs to know of a shard's tracks besides their positions.

    Attributes:
        fragments: the tracks within the frames that the shard reports.
        habits: what they teach about motion and appearance.
    """

    fragments: Fragments
    habits: Habits


@dataclass(frozen=True)
class Identities:
    """The identities of the tracks of a shard in the recording.

    Attributes:
        local: (K,) identity within the shard, sorted.
        identity: (K,) person in the recording; people who first appear later have higher numbers,
            not all of which occur.
        stop: (K,) frame before which the track ends, because the person goes on as another one.
    """

    local: Int[np.ndarray, " k"]
    identity: Int[np.ndarray, " k"]
    stop: Int[np.ndarray, " k"]

    def of(self, local: Int[np.ndarray, " m"]) -> Pairs:
        """(M,) identity and (M,) stop of tracks of the shard; each must be known."""
        at = np.searchsorted(self.local, local)
        return self.identity[at], self.stop[at]


def identify_recording(
    summaries: Sequence[ShardSummary], matched: Sequence[Pairs]
) -> list[Identities]:
    """Join the tracks of all shards by their matches, then by looks and motion across gaps.

    Args:
        summaries: of the shards, in order of time.
        matched: for each shard but the last, the identities in it and in the next one of the pairs
            that are one person.

    Returns:
        The identities of each shard.
    """
    fragments = [summary.fragments for summary in summaries]
    count = [len(part) for part in fragments]
    table = _concatenate(fragments)
    begin = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    paired = [np.zeros((2, 0), np.int64)]
    for index, pairs in enumerate(matched):
        known = [fragments[index + at].identity for at in (0, 1)]
        # A track that only the overlap has is not reported by its shard.
        both = np.isin(pairs[0], known[0]) & np.isin(pairs[1], known[1])
        rows = [np.searchsorted(known[at], pairs[at][both]) for at in (0, 1)]
        paired.append(begin[[index, index + 1], None] + np.array(rows))
    before, after = np.concatenate(paired, axis=1)
    links = coo_array((np.ones(len(before)), (before, after)), shape=(len(table), len(table)))
    _, person = connected_components(links, directed=False)
    people = _merge(table, person)
    habits = add_habits([summary.habits for summary in summaries])
    first_of, stop = chains(people, link_fragments(people, habits))
    order = np.lexsort((*people.begin.T[::-1], people.begin_sigma, people.first))
    columns = (table.identity, np.argsort(order)[first_of[person]], stop[person])
    by_shard = [np.split(column, begin[1:-1]) for column in columns]
    return [Identities(*parts) for parts in zip(*by_shard, strict=True)]


def _merge(table: Fragments, person: Int[np.ndarray, " k"]) -> Fragments:
    """One fragment per person from the fragments of several shards."""
    names = np.unique(person)
    earliest = np.lexsort((table.first, person))
    latest = np.lexsort((table.last, person))
    head = earliest[np.searchsorted(person[earliest], names)]
    tail = latest[np.searchsorted(person[latest], names, side="right") - 1]
    looks = np.zeros((len(names), table.looks.shape[1]))
    np.add.at(looks, person, table.boxes[:, None] * table.looks)
    boxes = np.zeros(len(names), np.int64)
    np.add.at(boxes, person, table.boxes)
    length = np.linalg.norm(looks, axis=1, keepdims=True)
    return Fragments(
        identity=names,
        first=table.first[head],
        last=table.last[tail],
        begin=table.begin[head],
        end=table.end[tail],
        begin_sigma=table.begin_sigma[head],
        end_sigma=table.end_sigma[tail],
        boxes=boxes,
        looks=looks / np.maximum(length, 1e-12),
    )


def _concatenate(fragments: Sequence[Fragments]) -> Fragments:
    """The fragments of all shards in one table."""
    width = max(part.looks.shape[1] for part in fragments)
    # Without any box, a shard does not know how long an embedding is.
    parts = [
        part if part.looks.shape[1] == width else replace(part, looks=np.zeros((len(part), width)))
        for part in fragments
    ]
    return jax.tree.map(lambda *columns: np.concatenate(columns), *parts)
