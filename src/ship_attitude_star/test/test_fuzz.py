"""Garbage in any field, tens of thousands of times: nothing is raised, and afterwards the node is as good as new."""

import copy
import pickle
from collections import Counter
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from small_voyage import FORE, INS, SECOND_NS, START_NS, Arrival, Run, clean_run, new_adapter, voyage

from ship_attitude_star.samples import Status

MESSAGES = 20_000
REFERENCE = "reference/gyro/imu"

NUMBERS = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 1e-320, 1e-160, 1e-9, 57.3, 100.0, 1e9, 1e154, 1e300, -1e308]
TEXTS = ["", "ins", "star_fore", "\x00", "deck" * 100, "θ—\n"]


def paths(message: Any, prefix: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """All fields that are no messages themselves."""
    found = []
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        nested = hasattr(value, "get_fields_and_field_types")
        found += paths(value, (*prefix, name)) if nested else [(*prefix, name)]
    return found


def spoil(message: Any, fields: list[tuple[str, ...]], rng: np.random.Generator) -> None:
    """Put garbage of the right type into one to three fields."""
    for index in rng.integers(0, len(fields), rng.integers(1, 4)).tolist():
        *parents, name = fields[index]
        holder = message
        for parent in parents:
            holder = getattr(holder, parent)
        setattr(holder, name, garbage(getattr(holder, name), name, rng))


def garbage(value: Any, name: str, rng: np.random.Generator) -> Any:
    if isinstance(value, str):
        return TEXTS[rng.integers(len(TEXTS))]
    if isinstance(value, float):
        return float(a_number(rng, value))
    if isinstance(value, np.ndarray) and rng.random() < 0.5:
        # A covariance, but of any size and rank, none included.
        root = rng.normal(size=(3, rng.integers(0, 4))) * 10.0 ** rng.uniform([-20.0] * 3, [1.0] * 3)[:, None]
        return (root @ root.T).ravel()
    if isinstance(value, np.ndarray):
        chosen = rng.random(value.size) < rng.choice([0.2, 1.0])
        return np.where(chosen, [a_number(rng, v) for v in value.tolist()], value)
    if name == "sec":
        return int(rng.choice([0, -1, -(2**31), 2**31 - 1, value - 1, value + 1, value - 3]))
    if name == "nanosec":
        return int(rng.choice([0, 999_999_999, 1_000_000_000, 2**32 - 1, rng.integers(0, SECOND_NS)]))
    return int(rng.choice([0, 1, 2, 3, 4, 255]))


def a_number(rng: np.random.Generator, value: float) -> float:
    kind = rng.integers(3)
    if kind == 0:
        return float(NUMBERS[rng.integers(len(NUMBERS))])
    return float(rng.normal() * 10.0 ** rng.uniform(-12, 3)) if kind == 1 else value * float(rng.normal())


def templates() -> list[Arrival]:
    """The clean messages of the stream; a reference says what the INS says."""
    arrivals = list(voyage())
    return arrivals + [Arrival(REFERENCE, a.message, a.receive_ns + 1) for a in arrivals if a.topic == INS]


def test_no_message_whatsoever_raises_or_does_damage() -> None:
    rng = np.random.default_rng(4711)
    adapter = new_adapter(references={"gyro": {}})
    clean = sorted(templates(), key=lambda a: a.receive_ns)
    fields = {a.topic: paths(a.message) for a in clean}
    run, now_ns, tried, mixed_in = Run(adapter), START_NS, Counter(), 12
    while tried["all"] < MESSAGES:
        # Good messages go on between, so that each round of garbage meets a filter at work.
        start_ns = now_ns
        for arrival in clean:
            now_ns = start_ns + arrival.receive_ns - START_NS
            good = later(arrival, start_ns - START_NS)
            take(run, good, now_ns)
            pickled = pickle.dumps(good.message)  # copies three times as fast as deepcopy()
            for _ in range(mixed_in):
                bad = pickle.loads(pickled)
                spoil(bad, fields[arrival.topic], rng)
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
        take(run, later(arrival, now_ns + SECOND_NS - START_NS), now_ns + SECOND_NS + arrival.receive_ns - START_NS)
    last = run.messages("ship/attitude")[-1]
    assert last.status == Status.VALID
    clean_last = clean_run().messages("ship/attitude")[-1]
    for angle in ("heading", "pitch", "roll"):
        assert abs(getattr(last, angle) - getattr(clean_last, angle)) < 1e-9


def later(arrival: Arrival, ns: int) -> Arrival:
    message = copy.deepcopy(arrival.message)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(arrival.stamp_ns + ns, SECOND_NS)
    return Arrival(arrival.topic, message, arrival.receive_ns + ns)


def take(run: Run, arrival: Arrival, now_ns: int) -> None:
    """Hand over a message; all that comes of it must be fit to be sent."""
    run.now_ns = now_ns
    for topic, message in run.adapter.handle(arrival.topic, arrival.message, now_ns):
        serialize_message(message)
        if topic == "ship/attitude":
            run.published.append((now_ns, topic, message))
