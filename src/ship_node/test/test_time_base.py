"""Steps of the time base are detected by the clocks of all inputs; one clock alone, delays and disorder are no steps.
"""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from ship_node.health.time_base import TimeBase

S = 1_000_000_000
START_NS = 1_700_000_000 * S
PERIODS_S = {"ins/imu": 0.01, "star/fore": 0.2, "gnss/fix": 1.0, "met/pressure": 10.0}
LATENCY_S = {"ins/imu": 0.003, "star/fore": 0.12, "gnss/fix": 0.2, "met/pressure": 0.05}

Delay = Callable[[str, float], float]
Step = Callable[[str, float], float]


def arrivals(duration_s: float, step_s: Step, delay_s: Delay, **periods_s: float) -> Iterator[tuple[float, str, float]]:
    """Yield (timeout-clock time s, topic, stamp s) in order of arrival; a message delayed by a day or more never
    arrives.
    """
    found = []
    for number, (topic, period_s) in enumerate({**PERIODS_S, **periods_s}.items()):
        for valid_s in np.arange(0.0017 * number, duration_s, period_s) if np.isfinite(period_s) else ():
            waiting_s = valid_s + LATENCY_S[topic] + delay_s(topic, valid_s)
            if waiting_s < valid_s + 86_400.0:
                found.append((waiting_s, topic, valid_s + step_s(topic, valid_s)))
    yield from sorted(found)


def detected_steps(
    step_s: Step,
    delay_s: Delay = lambda topic, valid_s: 0.0,
    duration_s: float = 60.0,
    computer_s: Callable[[float], float] | None = None,
    node_follows: bool = True,
    clocks: TimeBase | None = None,
    **periods_s: float,
) -> list[tuple[float, float]]:
    """Return (timeout-clock time s, step s) of each detected step of the time base.

    Args:
        step_s: offset of a topic's clock at a time.
        delay_s: delay of a message in addition to the usual latency.
        duration_s: duration of the run.
        computer_s: offset of the computer's clock at a time, if a live node reports its steps.
        node_follows: True if the node's clock has the offset of the INS clock; not used with ``computer_s``.
        clocks: the time base; None for a new one.
        periods_s: topic → its period, if it is not the usual one; infinite for none.
    """
    clocks, steps, last_s = TimeBase() if clocks is None else clocks, [], 0.0
    for waiting_s, topic, stamp_s in arrivals(duration_s, step_s, delay_s, **periods_s):
        waiting_ns = START_NS + round(waiting_s * S)
        off_s = computer_s(waiting_s) if computer_s else step_s("ins/imu", waiting_s) if node_follows else 0.0
        if computer_s is not None and off_s != last_s:
            clocks.note_computer_step(round((off_s - last_s) * S), waiting_ns)
            last_s = off_s
        step_ns = clocks.add_arrival(topic, START_NS + round(stamp_s * S), waiting_ns + round(off_s * S), waiting_ns)
        if step_ns is not None:
            steps.append((waiting_s, step_ns / S))
    return steps


@pytest.mark.parametrize("step_s", [-900.0, -300.0, -10.0, -1.0, -0.7, 2.0, 10.5, 300.0, 900.0])
@pytest.mark.parametrize("at_s", [20.0, 20.005, 20.3])
def test_a_step_of_all_stamps_is_detected_within_1_3_s(step_s: float, at_s: float) -> None:
    # A small step forward counts only if the stamps are ahead of the node's clock; else it may be the end of a delay.
    follows = step_s < 0.0 or step_s > 10.0
    steps = detected_steps(lambda topic, valid_s: step_s if valid_s >= at_s else 0.0, node_follows=follows)
    ((waiting_s, detected_s),) = steps
    assert waiting_s - at_s < 1.55, "the fix comes once a second"
    assert detected_s == pytest.approx(step_s, abs=1e-6)


@pytest.mark.parametrize("step_s", [-900.0, -1.0, -0.15])
def test_a_step_back_of_the_computers_clock_is_confirmed_by_the_first_input(step_s: float) -> None:
    def step_at(waiting_s: float) -> float:
        return step_s if waiting_s >= 20.0 else 0.0

    ((waiting_s, detected_s),) = detected_steps(lambda topic, valid_s: step_at(valid_s), computer_s=step_at)
    assert 20.0 <= waiting_s < 20.02
    assert detected_s == step_s


@pytest.mark.parametrize("step_s", [0.2, 1.0, 900.0])
def test_a_step_forward_of_the_computers_clock_is_confirmed_by_all_inputs(step_s: float) -> None:
    def step_at(waiting_s: float) -> float:
        return step_s if waiting_s >= 20.0 else 0.0

    ((waiting_s, detected_s),) = detected_steps(lambda topic, valid_s: step_at(valid_s), computer_s=step_at)
    assert 20.3 <= waiting_s < 21.5
    assert detected_s == step_s


def test_an_offset_for_30_s_is_two_steps() -> None:
    steps = detected_steps(lambda topic, valid_s: 900.0 if 20.0 <= valid_s < 50.0 else 0.0, duration_s=80.0)
    assert [step_s for _, step_s in steps] == [pytest.approx(900.0), pytest.approx(-900.0)]


@pytest.mark.parametrize("alone", PERIODS_S)
@pytest.mark.parametrize("step_s", [-300.0, -1.0, 300.0])
@pytest.mark.parametrize("lasts_s", [5.0, 100.0])
def test_one_device_alone_is_never_a_step_of_the_time_base(alone: str, step_s: float, lasts_s: float) -> None:
    def step(topic: str, valid_s: float) -> float:
        return step_s if topic == alone and 20.0 <= valid_s < 20.0 + lasts_s else 0.0

    assert detected_steps(step, duration_s=150.0, node_follows=False) == []


@pytest.mark.parametrize("step_s", [-1.0, -5.0])
def test_an_input_that_moved_and_timed_out_leaves_no_pending_step(step_s: float) -> None:
    """The star sensor steps alone and times out two seconds later; then a link delays all other inputs permanently by
    the size of the step.
    """

    def delay_s(topic: str, valid_s: float) -> float:
        return 1e6 if topic == "star/fore" and valid_s > 22.0 else -step_s * (topic != "star/fore" and valid_s > 30.0)

    clocks = TimeBase()
    steps = detected_steps(
        lambda topic, valid_s: step_s * (topic == "star/fore" and valid_s > 20.0), delay_s, clocks=clocks
    )
    assert steps == []
    assert not clocks.is_step_pending


@pytest.mark.parametrize("later_s", [0.0, -300.0])
def test_the_computers_clock_alone_is_no_step_of_the_time_base(later_s: float) -> None:
    """A step of one device's clock twenty seconds later makes no difference."""

    def step(topic: str, valid_s: float) -> float:
        return later_s if topic == "star/fore" and valid_s >= 40.0 else 0.0

    assert detected_steps(step, computer_s=lambda waiting_s: -300.0 if waiting_s >= 20.0 else 0.0) == []


@pytest.mark.parametrize("alone_s", [-300.0, 300.0])
def test_a_device_with_a_long_offset_steps_with_the_others(alone_s: float) -> None:
    def step(topic: str, valid_s: float) -> float:
        return alone_s * (topic == "star/fore" and valid_s >= 20.0) - 5.0 * (valid_s >= 120.0)

    ((waiting_s, step_s),) = detected_steps(step, duration_s=150.0, node_follows=False)
    assert 120.0 < waiting_s < 122.0
    assert step_s == pytest.approx(-5.0)


def test_a_clock_that_drifts_ahead_has_not_moved() -> None:
    clocks = TimeBase()
    assert detected_steps(lambda topic, valid_s: 0.02 * valid_s * (topic == "star/fore"), clocks=clocks) == []
    assert not clocks.is_step_pending


def test_an_input_with_both_times_confirms_no_step() -> None:
    """Two publishers send INS samples: the clock of one steps with the other inputs, that of the other does not."""

    def step(topic: str, valid_s: float) -> float:
        return 0.0 if topic == "ins/imu" and round(100.0 * valid_s) % 2 else -300.0 * (valid_s >= 20.0)

    assert detected_steps(step, node_follows=False, **{"gnss/fix": np.inf, "met/pressure": np.inf}) == []


def test_devices_that_follow_one_after_another_are_one_step() -> None:
    """The INS first, the star sensor five seconds later, the receiver after ten."""
    at_s = {"ins/imu": 20.0, "star/fore": 25.0, "gnss/fix": 30.0, "met/pressure": 20.0}
    ((waiting_s, step_s),) = detected_steps(lambda topic, valid_s: -300.0 if valid_s >= at_s[topic] else 0.0)
    assert 30.0 < waiting_s < 31.6
    assert step_s == pytest.approx(-300.0)


def test_an_input_without_messages_follows_a_step() -> None:
    def delay_s(topic: str, valid_s: float) -> float:
        return 1e6 if topic == "star/fore" and 15.0 <= valid_s < 40.0 else 0.0

    ((waiting_s, _),) = detected_steps(lambda topic, valid_s: -300.0 if valid_s >= 20.0 else 0.0, delay_s)
    assert waiting_s < 21.6


@pytest.mark.parametrize("seed", range(5))
def test_disorder_within_two_seconds_is_no_step(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert detected_steps(lambda topic, valid_s: 0.0, lambda topic, valid_s: float(rng.uniform(0.0, 2.0))) == []


@pytest.mark.parametrize(("periods_s", "late_s", "share", "end_s"), [
    ({"star/fore": np.inf, "met/pressure": 5.0}, 1.9, 0.95, 40.0), ({"ins/imu": np.inf}, 1.0, 0.5, 22.0),
])  # fmt: skip
def test_bursts_that_come_late_are_no_step(periods_s, late_s: float, share: float, end_s: float) -> None:
    """The messages of the first part of each second from 20 s to ``end_s`` arrive ``late_s`` later, among the others.
    """

    def delay_s(topic: str, valid_s: float) -> float:
        return late_s if 20.0 <= valid_s < end_s and valid_s % 1.0 < share else 0.0

    assert detected_steps(lambda topic, valid_s: 0.0, delay_s, **periods_s) == []


def test_a_longer_latency_after_a_step_is_no_further_step() -> None:
    """The clocks step back by 300 s; from 40 s on all messages take a second longer."""
    steps = detected_steps(
        lambda topic, valid_s: -300.0 * (valid_s >= 20.0), lambda topic, valid_s: float(valid_s >= 40.0), 80.0
    )
    assert [step_s for _, step_s in steps] == [-300.0]


@pytest.mark.parametrize("step_s", [-0.7, -15.0])
def test_a_slow_input_that_seemed_late_has_stepped_with_the_next_one(step_s: float) -> None:
    """The first message after the step is a pressure, which alone seems late. The star sensor shows the step;
    afterwards no step is pending.
    """
    clocks = TimeBase()
    periods_s = {"ins/imu": np.inf, "gnss/fix": np.inf, "met/pressure": 20.0}
    steps = detected_steps(
        lambda topic, valid_s: step_s * (valid_s >= 20.0), clocks=clocks, duration_s=50.0, **periods_s
    )
    assert [detected_s for _, detected_s in steps] == [pytest.approx(step_s)]
    assert steps[0][0] < 22.0
    assert not clocks.is_step_pending


def test_the_step_is_that_of_the_fastest_input() -> None:
    """The latency of the first fix after the step is longer by 0.3 s."""
    ((_, step_s),) = detected_steps(
        lambda topic, valid_s: -300.0 * (valid_s >= 20.0),
        lambda topic, valid_s: 0.3 if topic == "gnss/fix" and 20.0 <= valid_s < 21.0 else 0.0,
        **{"met/pressure": np.inf},
    )
    assert step_s == -300.0


def test_an_input_far_ahead_is_unused_while_others_are_present() -> None:
    """The input is unused even if the node's clock is ahead too, so that the stamps are not rejected."""
    clocks = TimeBase()

    def ahead_s(topic: str, valid_s: float) -> float:
        return 300.0 if topic == "ins/imu" and valid_s >= 20.0 else 0.0

    assert detected_steps(ahead_s, duration_s=150.0, clocks=clocks) == []
    assert clocks.ahead_ns("ins/imu") == 300 * S


@pytest.mark.parametrize("held_up_s", [0.8, 3.0, 30.0])
def test_a_stalled_link_is_no_step(held_up_s: float) -> None:
    """All messages of the meantime arrive at once, as after a stall of the network or of the node."""

    def delay_s(topic: str, valid_s: float) -> float:
        return max(20.0 + held_up_s - valid_s, 0.0) if valid_s >= 20.0 else 0.0

    assert detected_steps(lambda topic, valid_s: 0.0, delay_s) == []


def test_utc_is_ambiguous_in_a_leap_second() -> None:
    midnight_ns = 1_483_228_800 * S  # 2017-01-01, after 2016-12-31T23:59:60
    clocks = TimeBase()
    misdated = [clocks.is_misdated(midnight_ns + round(s * S), 0) for s in (-1.5, -0.5, 0.0, 0.5, 1.0)]
    assert misdated == [False, False, True, True, False], "the first of the new day, as long as no clock stepped"
    start_ns = midnight_ns - 20 * S
    for waiting_s, topic, stamp_s in arrivals(20.5, lambda _, s: -1.0 if s >= 20.0 else 0.0, lambda _, s: 0.0):
        now_ns = start_ns + round(waiting_s * S)
        if waiting_s >= 20.0 and not clocks.steps:
            clocks.note_computer_step(-S, now_ns)
        clocks.add_arrival(topic, start_ns + round(stamp_s * S), now_ns, now_ns)
    assert clocks.steps == 1
    misdated = [clocks.is_misdated(midnight_ns + round(s * S), now_ns) for s in (-1.5, -0.5, 0.0, 0.5)]
    assert misdated == [False, True, False, False], "the last of the old day, repeated"
    assert clocks.is_misdated(midnight_ns, now_ns + 4 * S), "another one is not known"
