"""State published by the alert node: conversion to a message and back."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ship_bags.message_factory import RosidlFactory
from ship_geometry.rotations import ARCSEC
from ship_testing.suite_states import (
    NOW_NS,
    angle_over_limit,
    angles_timed_out,
    source,
    source_out,
    suite_state,
    unsafe_angle,
)
from ship_watch.published_state import (
    MAX_AGE_NS,
    PERIOD_NS,
    STATE_TYPE,
    change_key,
    published_state,
    suite_state_fields,
)
from ship_watch.suite_state import Presence, Safety, SuiteState

PICTURES = {
    "all well": suite_state(),
    "two faults": suite_state(
        source_out("star.fore", "excluded", disagreement="reads 49″ high", residual=8.1, out_since_ns=NOW_NS),
        source_out("lights", "needs ship_attitude", because_of="ship_attitude"),
        unsafe_angle("heading", "ins"),
        angle_over_limit("roll"),
        source("star.starboard", mounting_shift=51.0 * ARCSEC),
        source("gnss", presence=Presence.OFF),
    ),
    "silent": suite_state(
        *angles_timed_out("heading", "pitch", "roll"), ages_s={"stars": math.inf, "lights": math.nan, "ins": 7.0}
    ),
}


def received_state(shown: SuiteState, elapsed_ns: int = 0) -> SuiteState:
    """Return the state of a viewer whose own state is different, after receiving the published one."""
    message = RosidlFactory().make(STATE_TYPE, **suite_state_fields(shown))
    own = replace(shown, angles=(), sources=(), ages_s={}, pointing_by="?", horizon="?", waiting_for="?")
    return published_state(message, NOW_NS).merge_into(own, NOW_NS + elapsed_ns)


def are_equal(first: object, second: object) -> bool:
    """True if two values are equal where NaN equals NaN."""
    return repr(first) == repr(second)


@pytest.mark.parametrize("shown", PICTURES.values(), ids=list(PICTURES))
def test_received_state_equals_the_published_one(shown: SuiteState) -> None:
    """All fields of angles, ages and sources are equal, except fields of an angle that only alerts use."""
    received = received_state(shown)
    assert are_equal(received.sources, shown.sources)
    assert are_equal(
        received.angles, tuple(replace(angle, over_limit_s=0.0, unheld_safety=None) for angle in shown.angles)
    )
    assert are_equal(
        dict(received.ages_s), {name: shown.ages_s.get(name, math.inf) for name in ("stars", "lights", "ins")}
    )
    assert (received.pointing_by, received.horizon) == (shown.pointing_by, shown.horizon)
    assert received.overall == shown.overall


def test_ages_grow_only_while_a_message_is_overdue() -> None:
    """Ages are as published for half a second; then they grow by the delay."""
    shown = PICTURES["all well"]
    ages = {late: received_state(shown, late).angles[0].age_s for late in (0, PERIOD_NS, PERIOD_NS + 10**9)}
    assert [round(age_s - shown.angles[0].age_s, 6) for age_s in ages.values()] == [0.0, 0.0, 1.0]
    state = published_state(RosidlFactory().make(STATE_TYPE, **suite_state_fields(shown)), NOW_NS)
    assert state.is_current(NOW_NS + MAX_AGE_NS)
    assert not state.is_current(NOW_NS + MAX_AGE_NS + 1)


@pytest.mark.parametrize("what", ["safety", "presence"])
def test_unknown_safety_or_presence_is_refused(what: str) -> None:
    """A message of another version is never shown as SAFE."""
    message = RosidlFactory().make(STATE_TYPE, **suite_state_fields(PICTURES["all well"]))
    setattr(message.angles[0] if what == "safety" else message.sources[0], what, 7)
    with pytest.raises(ValueError, match="7"):
        published_state(message, NOW_NS)


def test_long_lists_and_texts_are_cut() -> None:
    """At most 256 entries, and texts of about a thousand characters, are taken from a message."""
    message = RosidlFactory().make(STATE_TYPE, **suite_state_fields(PICTURES["all well"]))
    message.sources = [message.sources[0]] * 2000
    message.sources[0].reason = "x" * 10**6
    state = published_state(message, NOW_NS)
    assert len(state.sources) <= 256
    assert len(state.sources[0].reason) <= 1024


def test_safety_and_presence_are_changes_and_figures_are_not() -> None:
    """Changes of safety or presence are published at once, other changes after half a second."""
    well = PICTURES["all well"]
    running = replace(well, angles=tuple(replace(angle, accuracy_95=np.pi, age_s=0.3) for angle in well.angles))
    assert change_key(running) == change_key(well)
    worse = replace(well, angles=(replace(well.angles[0], safety=Safety.CAUTION), *well.angles[1:]))
    assert change_key(worse) != change_key(well)
    assert change_key(suite_state(source_out("ins", "no data"))) != change_key(well)
