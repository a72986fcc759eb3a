"""Messages given to an adapter one by one, as in a live node."""

from collections.abc import Callable
from typing import Any

from ship_node.adapters.adapter import Adapter
from ship_node.messages.inputs_outputs import Arrival, Batch, BatchOutputs, OutputMessage, PlacedMessages
from ship_replay.offline.adapter_chain import AdapterChain


def process_message(
    adapter: Adapter | AdapterChain, topic: str, message: Any, receive_ns: int, waiting_ns: int | None = None
) -> list[OutputMessage]:
    """Let an adapter process one message; return the messages to publish."""
    return adapter.process(Batch.of_message(topic, message, receive_ns, waiting_ns)).output_messages()


def process_each(
    batch: Batch, process: Callable[[Arrival], list[OutputMessage]], tick: Callable[[int, int], list[OutputMessage]]
) -> BatchOutputs:
    """Process a batch without blocks, arrival by arrival, for an adapter without a core."""
    messages = []
    for place, arrival in enumerate(batch.arrivals):
        published = process(arrival) if arrival.topic else tick(arrival.receive_ns, arrival.waiting_ns)
        messages.append(PlacedMessages(place, place, published))
    return BatchOutputs(messages)
