"""A sink of a replay that keeps what it is given, instead of a bag."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from ship_bags.message_store import serialize

Published = dict[str, list[tuple[int, bytes]]]
"""Topic → log time and bytes of each message."""


class KeptSink:
    """Keeps all messages.

    Attributes:
        published: what was written.
    """

    def __init__(self) -> None:
        self.published: Published = defaultdict(list)

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Keep a message."""
        self.write_raw(topic, "", serialize(message), log_time_ns)

    def write_raw(self, topic: str, _type_name: str, data: bytes, log_time_ns: int) -> None:
        """Keep a message that is bytes already."""
        self.published[topic].append((log_time_ns, bytes(data)))

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: np.ndarray, data: Sequence[bytes], log_times_ns: np.ndarray
    ) -> None:
        """Keep messages of several topics: ``topics`` by the number in ``of_topic``."""
        for number, content, time_ns in zip(of_topic.tolist(), data, log_times_ns.tolist(), strict=True):
            self.published[topics[number][0]].append((time_ns, bytes(content)))
