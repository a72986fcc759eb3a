"""Random values in any field, thousands of times: nothing is raised, and afterwards the node works as before."""

import copy
import pickle

import numpy as np
import pytest

from ship_estimation.time_order.outcome import Status
from ship_node.live.adapter_calls import message_bytes
from ship_testing.adapter_runs import SECOND_NS, START_NS, Arrival
from ship_testing.garbage import paths, put_garbage
from ship_testing.one_message import process_message
from ship_testing.small_session import ALL_TOPICS, SHIP, Run, fault_free_run, new_adapter, session

MESSAGES = 10_000


@pytest.mark.slow
def test_no_message_whatsoever_raises_or_does_damage() -> None:
    rng = np.random.default_rng(4712)
    adapter = new_adapter()
    fields = {a.topic: paths(a.message) for a in session()}
    run, now_ns, tried = Run(adapter), START_NS, 0
    while tried < MESSAGES:
        # Valid messages are sent in between, so that each round of garbage reaches a running filter.
        start_ns = now_ns
        for arrival in session():
            now_ns = start_ns + arrival.receive_ns - START_NS
            good = shifted_by(arrival, start_ns - START_NS)
            give_message(run, good, now_ns)
            if arrival.topic == SHIP and start_ns == START_NS:
                continue  # No lights are used while both the encoders and the ship contradict themselves.
            pickled = pickle.dumps(good.message)  # copies three times as fast as deepcopy()
            for _ in range(6):
                bad = pickle.loads(pickled)
                put_garbage(bad, fields[arrival.topic], rng)
                give_message(run, Arrival(good.topic, bad, now_ns), now_ns)
                tried += 1
            if tried % 60 == 0:
                run.published += [(now_ns, *item) for item in adapter.tick(now_ns)]
        now_ns += SECOND_NS // 10
    assert np.all(np.isfinite(adapter.core.state.mean))
    assert np.all(np.diagonal(adapter.core.state.covariance) >= 0.0)
    reasons = set().union(*(run.reasons(topic) for topic in ALL_TOPICS))
    expected = {"non_finite", "bad_quaternion", "bad_covariance", "bad_stamp", "frame", "future", "late", "units"}
    assert reasons >= expected | {"duplicate", "conflict", "covariance_unknown", "not_fixed", "unknown_sensor", "gap"}
    assert reasons >= {"light_conflict", "gate"}

    adapter.service("reset", now_ns)
    for arrival in session():
        give_message(
            run, shifted_by(arrival, now_ns + SECOND_NS - START_NS), now_ns + SECOND_NS + arrival.receive_ns - START_NS
        )
    last, clean_last = run.pointings[-1], fault_free_run().pointings[-1]
    assert last.status == Status.VALID
    for angle in ("azimuth", "elevation", "image_rotation"):
        assert abs(getattr(last, angle) - getattr(clean_last, angle)) < 1e-9


def shifted_by(arrival: Arrival, ns: int) -> Arrival:
    message = copy.deepcopy(arrival.message)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(arrival.stamp_ns + ns, SECOND_NS)
    return Arrival(arrival.topic, message, arrival.receive_ns + ns)


def give_message(run: Run, arrival: Arrival, now_ns: int) -> None:
    """Pass a message to the adapter; assert that all outputs can be sent."""
    run.now_ns = now_ns
    for topic, message in process_message(run.adapter, arrival.topic, arrival.message, now_ns):
        message_bytes(message)
        if topic == "theodolite/pointing":
            run.published.append((now_ns, topic, message))
