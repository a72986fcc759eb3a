"""Garbage in any field of any input of star_attitude: nothing is raised, and afterwards the node works as before."""

import pickle

import numpy as np
import pytest

from ship_node.live.adapter_calls import message_bytes
from ship_testing.adapter_runs import SECOND_NS, START_NS, stamp_of
from ship_testing.garbage import paths, put_garbage
from ship_testing.one_message import process_message
from ship_testing.small_voyage import run_adapter
from ship_testing.star_voyage import FIX, FORE, INS, PRESSURE, STARBOARD, new_adapter, published_bytes, voyage

ROUNDS, MIXED_IN = 3, 12


@pytest.mark.slow
def test_no_message_whatsoever_raises_or_does_damage() -> None:
    rng = np.random.default_rng(4711)
    adapter = new_adapter()
    fields = {arrival.topic: paths(arrival.message) for arrival in voyage()}
    tried = 0
    for round_ in range(ROUNDS):
        adapter.clock_jumped_back(START_NS)
        # Correct messages are mixed in, so that the garbage meets a working node.
        for arrival in voyage():
            published = process_message(adapter, arrival.topic, arrival.message, arrival.receive_ns)
            pickled = pickle.dumps(arrival.message)
            for copy in range(MIXED_IN):
                bad = pickle.loads(pickled)
                # Stamps differ by milliseconds, else each copy would repeat a stamp; in the last round one copy does.
                earlier_ns = stamp_of(bad) - 1_000_000 * (copy + (round_ < ROUNDS - 1))
                bad.header.stamp.sec, bad.header.stamp.nanosec = divmod(earlier_ns, SECOND_NS)
                put_garbage(bad, fields[arrival.topic], rng)
                published += process_message(adapter, arrival.topic, bad, arrival.receive_ns)
                tried += 1
            published += adapter.tick(arrival.receive_ns)
            for _, message in published:
                message_bytes(message)
    assert tried > 4000
    reasons = {message.topic: set(message.reasons) for message in adapter.health.messages(adapter.factory, START_NS)}
    assert reasons[FORE] | reasons[STARBOARD] >= {
        "bad_stamp", "future", "frame", "unknown_sensor", "duplicate", "conflict", "late", "non_finite", "units",
        "bad_covariance", "misidentified", "below_horizon", "covariance_unknown",
    }  # fmt: skip
    assert reasons[FIX] >= {"bad_stamp", "future", "non_finite", "units", "bad_covariance", "conflict"}
    assert reasons[PRESSURE] >= {"bad_stamp", "non_finite", "units", "bad_covariance"}
    assert reasons[INS] >= {"bad_quaternion", "non_finite", "frame"}

    adapter.clock_jumped_back(START_NS)
    assert published_bytes(run_adapter(adapter, voyage())) == published_bytes(run_adapter(new_adapter(), voyage()))
