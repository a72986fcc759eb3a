"""Published protection levels compared with those of each output."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ship_estimation.time_order.outcome import Status
from ship_node.adapters.node_adapter import NodeAdapter
from ship_testing.adapter_runs import AdapterRun, Arrival, hand_over, stamp_of


class ProtectionLevelRun(AdapterRun):
    """Run that computes the level of each output at its publication."""

    adapter: NodeAdapter

    def __init__(self, adapter: NodeAdapter, arrivals: Iterable[Arrival], until_ns: int = 0) -> None:
        super().__init__(adapter)
        self.level_of: dict[int, np.ndarray] = {}
        to_messages = adapter._estimate_messages

        def to_noted_messages(estimate: Any) -> Any:
            if estimate.status is not Status.INVALID:
                self.level_of[estimate.time_ns] = adapter.core.integrity(estimate).level
            return to_messages(estimate)

        adapter._estimate_messages = to_noted_messages
        hand_over(self, arrivals, until_ns)

    def published_and_own_levels(self) -> list[tuple[Any, np.ndarray, np.ndarray]]:
        """Return each output that is not INVALID, with the last published levels and the output's own levels, rad."""
        published, found = np.full(3, np.nan), []
        for _, topic, message in self.published:
            if topic == self.adapter.integrity_topic:
                published = np.array(message.protection_level)
            elif topic == self.adapter.main_topic and message.status != Status.INVALID:
                found.append((message, published, self.level_of[stamp_of(message)]))
        return found

    def exceedances(self) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Return (stamp, published, own levels) of outputs with an own level above 1.05 times the published level.

        Outputs are also returned if only the published or only the own levels contain NaN.
        """
        return [
            (stamp_of(message), published, own)
            for message, published, own in self.published_and_own_levels()
            if np.any(np.isfinite(published) & ~(own <= 1.05 * published))
            or (np.isnan(published).any() != np.isnan(own).any())
        ]
