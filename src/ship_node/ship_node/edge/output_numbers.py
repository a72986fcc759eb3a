"""The numbers of outputs on their way into messages: of one output as numbers, of many as columns of numbers.

What stands in which field is told once for each node; these functions serve the one output that a live node has at a
time and the many of a block alike.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_bags.message_factory import MessageFactory
from ship_node.edge.blocks import PublishedRows

Fields = Mapping[str, Any]
MessageFields = Iterator[tuple[str, str, Fields]]
"""Topic, type and fields of each message that outputs become."""


def joined(runs: Sequence[Any], names: Iterable[str]) -> list[Any]:
    """The values of some fields of several runs of outputs, one run after another: arrays, or lists.

    Example:
        >>> from types import SimpleNamespace
        >>> runs = [SimpleNamespace(text=["a"], angle=np.zeros(1)), SimpleNamespace(text=["b"], angle=np.ones(2))]
        >>> joined(runs, ["text", "angle"])
        [['a', 'b'], array([0., 1., 1.])]
    """
    if len(runs) == 1:
        return [getattr(runs[0], name) for name in names]
    columns = [[getattr(run, name) for run in runs] for name in names]
    return [list(chain(*values)) if isinstance(values[0], list) else np.concatenate(values) for values in columns]


def chosen(values: Any, places: NDArray[np.int64]) -> Any:
    """Some of the values of an array or a list."""
    return [values[place] for place in places] if isinstance(values, list) else values[places]


def as_numbers(*arrays: Any) -> list[Any]:
    """Of each array, whose first axis counts outputs, the numbers of the only output."""
    return [values[0].tolist() for values in arrays]


def as_columns(*arrays: Any) -> list[Any]:
    """Of each array, whose first axis counts outputs, the numbers of all of them by columns."""
    return [values.T for values in arrays]


def rows_by_kind(
    factory: MessageFactory,
    kinds: Iterable[Hashable],
    messages_of: Callable[[Any, NDArray[np.int64]], MessageFields],
) -> Iterator[PublishedRows]:
    """The messages of many outputs: those of each are in the order in which ``messages_of`` gives them.

    Args:
        factory: makes the messages.
        kinds: of each output; alike are those whose messages have the same texts, and nothing left out.
        messages_of: of a kind and the places of its outputs, their messages.
    """
    kinds = list(kinds)
    for kind in dict.fromkeys(kinds):
        places = np.array([place for place, other in enumerate(kinds) if other == kind])
        for topic, type_name, fields in messages_of(kind, places):
            yield PublishedRows(topic, factory.encoded_rows(type_name, len(places), **fields), places)
