"""Pooling of the metrics of several sequences."""

from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from typing import Any, TypeVar

from catfree.errors import InvalidInputError
from catfree.types._validation import as_instances

T = TypeVar("T")


def pool(
    parts: Iterable[T],
    kind: type[T],
    join: Callable[[list[Any]], Any],
    *,
    alike: dict[str, str],
    name: str,
) -> T:
    """Join the counts of metrics that were computed with the same options.

    Args:
        parts: metrics of the sequences.
        kind: their class, a dataclass.
        join: combines the values of one field from all parts.
        alike: the fields that must be equal in all parts, and the argument that sets each of them.
        name: of the metrics in error messages.

    Raises:
        InvalidInputError: if there are no parts, or their options differ.
    """
    listed = as_instances(parts, kind, "parts")
    if not listed or len({tuple(getattr(part, one) for one in alike) for part in listed}) > 1:
        raise InvalidInputError(
            f"Cannot combine {len(listed)} {name} results: give at least one, all computed with "
            f"the same {' and '.join(alike.values())}."
        )
    joined = {
        field.name: join([getattr(part, field.name) for part in listed])
        for field in fields(kind)  # type: ignore[arg-type]
        if field.name not in alike
    }
    return replace(listed[0], **joined)  # type: ignore[type-var]
