"""Give each person one identity over all shards of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from catfree._run._stitch import Fragments, Habits, add_habits, link_fragments

Pairs = tuple[Int[np.ndarray, "..."], Int[np.ndarray, "..."]]  # of different lengths


@dataclass(frozen=True)
class ShardSummary:
    """Everything that joining needs to know about a shard's tracks besides positions.

    Attributes:
        fragments: the tracks within the frames that the shard reports.
        habits: their statistics of motion and appearance.
    """

    fragments: Fragments
    habits: Habits


@dataclass(frozen=True)
class Identities:
    """Identities in the recording of the tracks of a shard.

    Attributes:
        local: (K,) identity within the shard, sorted.
        identity: (K,) person in the recording, numbered by first appearance; not every number
            occurs.
        stop: (K,) frame before which the track ends, because another track continues the person.
    """

    local: Int[np.ndarray, " k"]
    identity: Int[np.ndarray, " k"]
    stop: Int[np.ndarray, " k"]

    def of(self, local: Int[np.ndarray, " m"]) -> Pairs:
        """Return (M,) identity and (M,) stop of known tracks of the shard."""
        at = np.searchsorted(self.local, local)
        return self.identity[at], self.stop[at]


def identify_recording(
    summaries: Sequence[ShardSummary], matched: Sequence[Pairs]
) -> list[Identities]:
    """Join the tracks of all shards by their matches, then across gaps by appearance and motion.

    Args:
        summaries: one per shard, in order of time.
        matched: for each shard but the last, the matched identities in the shard and in the next.

    Returns:
        One per shard.
    """
    fragments = [summary.fragments for summary in summaries]
    count = [len(part) for part in fragments]
    table = _concatenate(fragments)
    begin = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    paired = [np.zeros((2, 0), np.int64)]
    for index, pairs in enumerate(matched):
        known = [fragments[index + at].identity for at in (0, 1)]
        # A track only in the overlap is not reported by its shard.
        both = np.isin(pairs[0], known[0]) & np.isin(pairs[1], known[1])
        rows = [np.searchsorted(known[at], pairs[at][both]) for at in (0, 1)]
        paired.append(begin[[index, index + 1], None] + np.array(rows))
    before, after = np.concatenate(paired, axis=1)
    links = coo_array((np.ones(len(before)), (before, after)), shape=(len(table), len(table)))
    _, person = connected_components(links, directed=False)
    people = _merge(table, person)
    habits = add_habits([summary.habits for summary in summaries])
    first_of, stop = link_fragments(people, habits)
    order = np.lexsort((*people.begin.T[::-1], people.begin_sigma, people.first))
    columns = (table.identity, np.argsort(order)[first_of[person]], stop[person])
    by_shard = [np.split(column, begin[1:-1]) for column in columns]
    return [Identities(*parts) for parts in zip(*by_shard, strict=True)]


def _merge(table: Fragments, person: Int[np.ndarray, " k"]) -> Fragments:
    """Merge the fragments of several shards into one fragment per person."""
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
    """Concatenate the fragments of all shards."""
    width = max(part.looks.shape[1] for part in fragments)
    # A shard without boxes does not know the length of an embedding.
    parts = [
        part if part.looks.shape[1] == width else replace(part, looks=np.zeros((len(part), width)))
        for part in fragments
    ]
    return jax.tree.map(lambda *columns: np.concatenate(columns), *parts)
