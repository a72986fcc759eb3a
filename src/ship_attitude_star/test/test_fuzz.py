"""20 000 messages with garbage in a field: the node raises nothing, and afterwards works as before."""

import copy
import pickle
from collections import Counter

import numpy as np
import pytest

from ship_estimation.time_order.outcome import Status
from ship_node.live.adapter_calls import message_bytes
from ship_testing.adapter_runs import SECOND_NS, START_NS, Arrival
from ship_testing.garbage import paths, put_garbage
from ship_testing.one_message import process_message
from ship_testing.small_voyage import FORE, INS, Run, fault_free_run, new_adapter, voyage

MESSAGES = 20_000
REFERENCE = "reference/gyro/imu"


def templates() -> list[Arrival]:
    """Return the correct messages of the voyage, and the INS messages again as those of a reference."""
    arrivals = list(voyage())
    return arrivals + [Arrival(REFERENCE, a.message, a.receive_ns + 1) for a in arrivals if a.topic == INS]


@pytest.mark.slow
def test_no_message_whatsoever_raises_or_does_damage() -> None:
    rng = np.random.default_rng(4711)
    adapter = new_adapter(references={"gyro": {}})
    clean = sorted(templates(), key=lambda a: a.receive_ns)
    fields = {a.topic: paths(a.message) for a in clean}
    run, now_ns, tried, mixed_in = Run(adapter), START_NS, Counter(), 12
    while tried["all"] < MESSAGES:
        # Correct messages are mixed in, so that each round of garbage meets a working filter.
        start_ns = now_ns
        for arrival in clean:
            now_ns = start_ns + arrival.receive_ns - START_NS
            good = delayed_copy(arrival, start_ns - START_NS)
            take(run, good, now_ns)
            pickled = pickle.dumps(good.message)  # copies three times as fast as deepcopy()
            for _ in range(mixed_in):
                bad = pickle.loads(pickled)
                put_garbage(bad, fields[arrival.topic], rng)
                take(run, Arrival(good.topic, bad, now_ns), now_ns)
                tried["all"] += 1
            if tried["all"] % 100 == 0:
                run.published += [(now_ns, *item) for item in adapter.tick(now_ns)]
        now_ns += SECOND_NS // 10
    assert np.all(np.isfinite(adapter.core.state.mean))
    assert np.all(np.diagonal(adapter.core.state.covariance) >= 0.0)
    reasons = set(run.reasons(INS)) | set(run.reasons(FORE))
    expected = {"non_finite", "bad_quaternion", "bad_covariance", "bad_stamp", "frame", "future", "late", "units"}
    assert reasons >= expected | {"duplicate", "conflict", "gate", "covariance_unknown", "too_few_stars"}

    adapter.service("reset", now_ns)
    for arrival in voyage():
        take(
            run,
            delayed_copy(arrival, now_ns + SECOND_NS - START_NS),
            now_ns + SECOND_NS + arrival.receive_ns - START_NS,
        )
    last = run.messages("ship/attitude")[-1]
    assert last.status == Status.VALID
    clean_last = fault_free_run().messages("ship/attitude")[-1]
    for angle in ("heading", "pitch", "roll"):
        assert abs(getattr(last, angle) - getattr(clean_last, angle)) < 1e-9


def delayed_copy(arrival: Arrival, ns: int) -> Arrival:
    message = copy.deepcopy(arrival.message)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(arrival.stamp_ns + ns, SECOND_NS)
    return Arrival(arrival.topic, message, arrival.receive_ns + ns)


def take(run: Run, arrival: Arrival, now_ns: int) -> None:
    """Hand over a message; all resulting messages must be serialisable."""
    run.now_ns = now_ns
    for topic, message in process_message(run.adapter, arrival.topic, arrival.message, now_ns):
        message_bytes(message)
        if topic == "ship/attitude":
            run.published.append((now_ns, topic, message))
