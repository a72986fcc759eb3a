"""Pause, step and stop of a playback. The rates are such that no test depends on the computer's speed."""

import math
import threading

import pytest

from ship_bags.live.playback_clock import PlaybackClock

FAST = 1e9
"""Bag seconds per second: every time is reached at once."""
SLOW = 1e-9
"""Bag seconds per second: no time is reached within this century."""
DAY_NS = 86_400 * 10**9


def test_an_event_is_played_when_it_is_due():
    clock = PlaybackClock(FAST)
    clock.start_at(0)
    assert clock.wait_until(DAY_NS, is_message=True)


def test_stop_ends_a_wait_and_every_later_one():
    clock = PlaybackClock(SLOW)
    clock.start_at(0)
    threading.Timer(0.05, clock.stop).start()
    assert not clock.wait_until(DAY_NS, is_message=True)
    assert not clock.wait_until(0, is_message=True)


def test_a_paused_clock_plays_only_steps():
    clock = PlaybackClock(FAST, paused=True)
    clock.start_at(0)
    passed = []

    def play():
        for name, is_message in [("tick", False), ("first", True), ("tick", False), ("second", True)]:
            if not clock.wait_until(DAY_NS, is_message):
                return
            passed.append(name)
            changed.set()

    changed = threading.Event()
    player = threading.Thread(target=play)
    player.start()
    assert clock.step()
    while passed != ["tick", "first"]:
        assert changed.wait(10)
        changed.clear()
    # The tick after the message waits for the next step, which does not occur.
    clock.stop()
    player.join(10)
    assert passed == ["tick", "first"]


def test_a_change_of_rate_ends_a_wait_that_began_before():
    clock = PlaybackClock(SLOW)
    clock.start_at(0)
    threading.Timer(0.05, clock.change_rate, [FAST / SLOW]).start()
    assert clock.wait_until(DAY_NS, is_message=True)
    assert clock.rate == pytest.approx(FAST)


def test_a_change_of_rate_does_not_move_the_bag_time_reached():
    clock = PlaybackClock(FAST)
    clock.start_at(0)
    assert clock.wait_until(DAY_NS, is_message=True)
    # From here on a bag second takes 31 years: the reached time remains reached, and a later time is not reached.
    clock.change_rate(SLOW / FAST)
    assert clock.wait_until(DAY_NS, is_message=True)
    threading.Timer(0.05, clock.stop).start()
    assert not clock.wait_until(10**6 * DAY_NS, is_message=True)


def test_while_paused_a_change_of_rate_plays_nothing():
    clock = PlaybackClock(SLOW, paused=True)
    clock.start_at(0)
    clock.change_rate(FAST / SLOW)
    threading.Timer(0.05, clock.stop).start()
    assert not clock.wait_until(DAY_NS, is_message=True)


def test_a_step_is_refused_while_playing():
    clock = PlaybackClock(FAST)
    clock.start_at(0)
    assert not clock.step()
    clock.pause()
    # The refused step is not pending after the pause.
    threading.Timer(0.05, clock.stop).start()
    assert not clock.wait_until(0, is_message=True)


def test_time_stands_still_in_a_pause():
    clock = PlaybackClock(FAST)
    clock.start_at(0)
    clock.pause()
    assert clock.behind_s(0) == 0.0
    clock.resume()
    assert clock.wait_until(DAY_NS, is_message=True)


@pytest.mark.parametrize("paused", [False, True])
def test_toggle_changes_the_state(paused):
    clock = PlaybackClock(FAST, paused)
    clock.toggle()
    assert clock.is_paused is not paused


@pytest.mark.parametrize("rate", [1e9, 1e18, 1e300, 1.7e308])
def test_a_huge_rate_is_as_fast_as_possible(rate):
    clock = PlaybackClock(rate)
    clock.start_at(0)
    for _ in range(3):
        assert clock.wait_until(DAY_NS, is_message=True)
        assert math.isfinite(clock.behind_s(DAY_NS))
        clock.change_rate(1e300)
