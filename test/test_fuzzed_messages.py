"""Random values in any field of any input of all nodes: no exception, and after a reset the outputs of a new node.

``make campaign`` sends 100 000 messages. The fuzz tests of the packages check rejections and their reasons.
"""

import os
import pickle
from typing import Any

import numpy as np
import pytest

from ship_node.live.adapter_calls import message_bytes
from ship_testing.adapter_runs import SECOND_NS, AdapterRun, Arrival, stamp_of
from ship_testing.every_input import NODES, Voyage, fault_free_run, voyage
from ship_testing.garbage import paths, put_garbage
from ship_testing.one_message import process_message

MESSAGES = int(os.environ.get("FUZZED_MESSAGES", "5000")) // len(NODES)


@pytest.mark.slow
@pytest.mark.parametrize("node", NODES)
def test_no_message_raises_or_has_an_effect_after_a_reset(node: str) -> None:
    rng = np.random.default_rng([20, NODES.index(node)])
    everything = voyage(node)
    adapter, start_ns, tried = everything.new_adapter(), everything.arrivals[0].receive_ns, 0
    per_arrival = min(12, -(-MESSAGES // len(everything.arrivals)))
    while tried < MESSAGES:
        adapter.clock_jumped_back(start_ns)
        # Valid messages continue in between, so that the bad messages arrive at a node in operation.
        for arrival in everything.arrivals:
            published = process_message(adapter, arrival.topic, arrival.message, arrival.receive_ns)
            for bad in garbage(arrival, per_arrival, rng):
                published += process_message(adapter, arrival.topic, bad, arrival.receive_ns)
                tried += 1
            published += adapter.tick(arrival.receive_ns)
            for _, message in published:
                message_bytes(message)
    assert set().union(*(health.reasons for health in adapter.health.messages(adapter.factory, start_ns))) >= {
        "bad_covariance", "bad_stamp", "conflict", "duplicate", "frame", "future", "late", "non_finite", "units",
    }  # fmt: skip
    adapter.clock_jumped_back(start_ns)
    assert run_all(everything, adapter).results() == fault_free_run(node).results()


def garbage(arrival: Arrival, count: int, rng: np.random.Generator) -> list[Any]:
    """Return copies with random values in some fields; the stamp of copy n is n milliseconds earlier, or random."""
    pickled, fields, copies = pickle.dumps(arrival.message), paths(arrival.message), []
    for number in range(count):
        bad = pickle.loads(pickled)
        bad.header.stamp.sec, bad.header.stamp.nanosec = divmod(stamp_of(bad) - 1_000_000 * number, SECOND_NS)
        put_garbage(bad, fields, rng)
        copies.append(bad)
    return copies


def run_all(everything: Voyage, adapter: Any) -> AdapterRun:
    return Voyage(lambda: adapter, everything.arrivals, everything.truth).run()
