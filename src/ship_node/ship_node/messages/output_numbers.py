"""Values for the fields of output messages: numbers for one output, columns for many outputs.

The assignment of values to fields is defined once per node, for single outputs (live) and for batches.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_bags.message_factory import MessageFactory
from ship_node.messages.batch import OutputRows

Fields = Mapping[str, Any]
MessageFields = Iterator[tuple[str, str, Fields]]
"""Topic, type and fields of each message."""


def join_fields(runs: Sequence[Any], names: Iterable[str]) -> list[Any]:
    """Return each named field, concatenated over several runs of outputs to one array or list.

    Example:
        >>> from types import SimpleNamespace
        >>> runs = [SimpleNamespace(text=["a"], angle=np.zeros(1)), SimpleNamespace(text=["b"], angle=np.ones(2))]
        >>> join_fields(runs, ["text", "angle"])
        [['a', 'b'], array([0., 1., 1.])]
    """
    if len(runs) == 1:
        return [getattr(runs[0], name) for name in names]
    columns = [[getattr(run, name) for run in runs] for name in names]
    return [list(chain(*values)) if isinstance(values[0], list) else np.concatenate(values) for values in columns]


def select_values(values: Any, places: NDArray[np.int64]) -> Any:
    """Return the values of an array or a list at some indices."""
    return [values[place] for place in places] if isinstance(values, list) else values[places]


def single_numbers(*arrays: Any) -> list[Any]:
    """Return the numbers of the only output in each array; the first axis of an array counts outputs."""
    return [values[0].tolist() for values in arrays]


def column_numbers(*arrays: Any) -> list[Any]:
    """Return each array, whose first axis counts outputs, transposed: one column for each number of an output."""
    return [values.T for values in arrays]


def rows_by_kind(
    factory: MessageFactory,
    kinds: Iterable[Hashable],
    messages_of: Callable[[Any, NDArray[np.int64]], MessageFields],
) -> Iterator[OutputRows]:
    """Return the messages of many outputs; the messages of one output are in the order of ``messages_of``.

    Args:
        factory: makes the messages.
        kinds: kind of each output; outputs of one kind have messages with the same texts and array lengths.
        messages_of: returns the messages for a kind and the indices of its outputs.
    """
    kinds = list(kinds)
    for kind in dict.fromkeys(kinds):
        places = np.array([place for place, other in enumerate(kinds) if other == kind])
        for topic, type_name, fields in messages_of(kind, places):
            yield OutputRows(topic, factory.encode_rows(type_name, len(places), **fields), places)
