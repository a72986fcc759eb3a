"""Sink of a replay that stores its messages in memory instead of a bag."""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

Published = dict[str, list[tuple[int, bytes]]]
"""Topic → log time and bytes of each message."""


class MemorySink:
    """Stores all messages.

    Attributes:
        published: the messages written.
    """

    def __init__(self) -> None:
        self.published: Published = defaultdict(list)

    def write_many(
        self, topics: Sequence[tuple[str, str]], of_topic: np.ndarray, data: Sequence[bytes], log_times_ns: np.ndarray
    ) -> None:
        """Store messages of several topics; ``of_topic`` is the index of each message's topic in ``topics``."""
        for number, content, time_ns in zip(of_topic.tolist(), data, log_times_ns.tolist(), strict=True):
            self.published[topics[number][0]].append((time_ns, bytes(content)))
