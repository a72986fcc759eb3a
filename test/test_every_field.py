"""Eight values in every field of every message of the theodolite: no exception, and consistent outputs.

A voyage runs for three seconds. Then, in a copy of the node for each case, one field of one topic has a bad value. If
both lights are visible, all following messages have the bad value; if one light is hidden, one message has it.
"""

import contextlib
import copy
import functools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import ship_testing.copies  # noqa: F401
from ship_estimation.time_order.outcome import Status
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_node.adapters.adapter import Adapter
from ship_node.live.adapter_calls import message_bytes
from ship_testing.adapter_runs import FACTORY, SECOND_NS, AdapterRun, Arrival, changed_copy, hand_over
from ship_testing.every_input import topics, voyage, worst_error_in_sigmas
from ship_testing.garbage import Path, paths, value_at
from theodolite_calib.filter.filter import CalibrationState
from theodolite_calib.samples.samples import BaselineSample, EncoderSample, Mode, ShipSample

NODE = "optical_axis"
BEFORE_S, AFTER_S = 3.0, 0.6
TEXTS = ["", "a", "b", "\x00", "deck" * 1000, "θ—", "theodolite_main", "0"]
DEGREES = 57.29577951308232
FROZEN = (EncoderSample, ShipSample, BaselineSample, AttitudeSample, CalibrationState)


def bad_values(value: Any) -> list[Any]:
    """Return eight bad values for a field that contains ``value``, such as NaN, zero, huge values, or another unit."""
    if isinstance(value, str):
        return TEXTS
    if isinstance(value, list):
        return [[], [""], ["a"], ["ins"] * 1000, ["\x00"], ["deck" * 1000], ["θ"], ["ins", "ins"]]
    if isinstance(value, float):
        return [np.nan, np.inf, -np.inf, 0.0, -value, 1e300, 1e-300, value * DEGREES]
    if isinstance(value, np.ndarray):
        unit, numbers = np.eye(3).ravel(), (np.nan, np.inf, -np.inf, 0.0)
        filled = [np.full(len(value), number) for number in numbers]
        return [*filled, -value, 1e300 * unit, 1e-300 * unit, value * DEGREES**2]
    return [0, -1, 1, 3, 9, 255, 2**31 - 1, value + 1]


@functools.cache
def start(one_light: bool) -> tuple[Adapter, dict[int, Any]]:
    """Return the node three seconds after the start, optionally with one of the lights hidden.

    The second result contains the objects that all copies of the node share, by their id: samples, states and factory.
    Nothing changes these objects.
    """
    run = AdapterRun(voyage(NODE).new_adapter())
    hand_over(run, [a for a in arrivals(one_light) if since_start_s(a) < BEFORE_S])
    copied: dict[int, Any] = {}
    copy.deepcopy(run.adapter, copied)
    shared = [FACTORY, *(one for one in copied[id(copied)] if isinstance(one, FROZEN))]
    return run.adapter, {id(one): one for one in shared}


def arrivals(one_light: bool) -> tuple[Arrival, ...]:
    everything = voyage(NODE).arrivals
    if not one_light:
        return everything
    return tuple(changed_copy(a, remove_beacon_b) if a.topic == "theodolite/beacons" else a for a in everything)


def remove_beacon_b(message: Any) -> None:
    message.beacons = [light for light in message.beacons if light.beacon_id != "b"]


def since_start_s(arrival: Arrival) -> float:
    return (arrival.receive_ns - voyage(NODE).arrivals[0].receive_ns) / SECOND_NS


def set_field(message: Any, path: Path, value: Any) -> None:
    *parents, name = path
    holder = functools.reduce(value_at, parents, message)
    # A value that a field of single precision or of eight bits cannot hold can never be received.
    with contextlib.suppress(AssertionError):
        setattr(holder, str(name), value)


@pytest.mark.slow
@pytest.mark.parametrize("one_light", [False, True], ids=["two lights", "one light"])
def test_the_voyage_is_consistent_without_faults(one_light: bool) -> None:
    run = voyage(NODE).run(arrivals(one_light))
    assert 0.1 < worst_error_in_sigmas(voyage(NODE), run) < 4.0
    last = run.messages("theodolite/pointing")[-40]
    assert (last.mode, last.status) == (Mode.ONE_LIGHT if one_light else Mode.TWO_LIGHTS, Status.VALID)


def cases(topic: str, one_light: bool) -> Iterator[tuple[Path, Any]]:
    message = next(a for a in arrivals(one_light) if a.topic == topic and since_start_s(a) > BEFORE_S).message
    for path in paths(message):
        for value in bad_values(functools.reduce(value_at, path, message)):
            yield path, value


@pytest.mark.slow
@pytest.mark.parametrize("topic", [topic for topic in topics(NODE) if "/b/" not in topic])
@pytest.mark.parametrize("one_light", [False, True], ids=["two lights", "one light"])
def test_no_value_of_any_field_raises_or_makes_an_output_inconsistent(topic: str, one_light: bool) -> None:
    rest = [a for a in arrivals(one_light) if BEFORE_S <= since_start_s(a) < BEFORE_S + AFTER_S]
    concerned = [index for index, arrival in enumerate(rest) if arrival.topic == topic]
    wrong = []
    for path, value in cases(topic, one_light):
        adapter, shared = start(one_light)
        run = AdapterRun(copy.deepcopy(adapter, dict(shared)))
        changed_indices = concerned[:1] if one_light else concerned
        changed = list(rest)
        for index in changed_indices:
            changed[index] = changed_copy(rest[index], lambda message, p=path, v=value: set_field(message, p, v))
        hand_over(run, changed)
        for _, _, message in run.published:
            message_bytes(message)
        if not worst_error_in_sigmas(voyage(NODE), run) < 5.0:
            wrong.append((path, value, worst_error_in_sigmas(voyage(NODE), run)))
    assert not wrong
