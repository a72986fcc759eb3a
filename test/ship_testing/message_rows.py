"""Messages as rows, as in a replay in blocks."""

import functools
from typing import Any

import numpy as np

from ship_bags.cdr_template import CdrRows, CdrTemplate
from ship_bags.message_store import definition_in, message_store, serialize


def rows(type_name: str, messages: list[Any]) -> CdrRows:
    """Return messages of one type with equal layout as rows."""
    data = [bytes(serialize(one)) for one in messages]
    definitions = functools.partial(definition_in, message_store())
    template = CdrTemplate.of_message(type_name, definitions, data[0])
    return CdrRows(template, np.frombuffer(b"".join(data), dtype=np.uint8).reshape(len(data), -1))
