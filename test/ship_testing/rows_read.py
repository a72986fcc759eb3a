"""Messages as rows, as a replay in blocks reads them."""

import functools
from typing import Any

import numpy as np

from ship_bags.cdr_template import CdrRows, CdrTemplate
from ship_bags.message_store import definition_in, message_store, serialize


def rows(type_name: str, messages: list[Any]) -> CdrRows:
    """Messages of one type that are all laid out alike."""
    data = [bytes(serialize(one)) for one in messages]
    definitions = functools.partial(definition_in, message_store())
    template = CdrTemplate.of_message(type_name, definitions, data[0])
    return CdrRows(template, np.frombuffer(b"".join(data), dtype=np.uint8).reshape(len(data), -1))
