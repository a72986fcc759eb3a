"""Recorded updates of the traced filter: equal states, and the kind of each update."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ship_testing.simulated_session import config, session, sweep
from theodolite_calib.filter.fault_detection import AxisExclusion
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.subfilters import BEACON_PREFIX, ENCODER, SHIP, TELESCOPE
from theodolite_calib.samples.encoder_check import EncoderJump
from theodolite_calib.samples.sighting import Sighting
from theodolite_calib.smoothing import TracedCalibration, TracedFilter

SETTINGS = config()


def sightings(count: int) -> list[Sighting]:
    times_s = np.arange(float(count))
    return session(SETTINGS, 3, times_s, sweep(times_s)).sightings


def step_state(filter_: CalibrationFilter, state: CalibrationState, sighting: Sighting) -> CalibrationState:
    predicted = filter_.propagate(state, sighting.time_ns, sighting.ship.correlated_covariance_n)
    comparison = filter_.compare(predicted, sighting)
    assert comparison is not None
    return filter_.update_by_beacons(predicted, sighting, comparison)[0]


def with_excluded(state: TracedCalibration, source: str) -> TracedCalibration:
    """Return the state of a filter that excludes a source."""
    assert state.time_ns is not None
    left_out = {source: AxisExclusion(state.time_ns, reason="it lies")}
    return replace(state, fault_state=replace(state.fault_state, excluded=left_out))


def test_its_states_are_those_of_the_filter() -> None:
    plain, traced = CalibrationFilter(SETTINGS), TracedFilter(SETTINGS)
    one, other = plain.initial_state(), traced.initial_state()
    for sighting in sightings(4):
        one, other = step_state(plain, one, sighting), step_state(traced, other, sighting)
        jump = EncoderJump(sighting.time_ns + 1, np.array([1e-3, 0.0]), 1e-4)
        one, other = plain.inflate_covariance(one, jump), traced.inflate_covariance(other, jump)
        for name in ("mean", "covariance_by_source", "solution_separation", "ship_covariance_n"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert {field.name for field in fields(other)} - {field.name for field in fields(one)} == {
        "last_update",
        "is_predicted_only",
    }


def test_a_sighting_leads_back_to_what_was_predicted() -> None:
    filter_ = TracedFilter(SETTINGS)
    first, second = sightings(2)
    before = step_state(filter_, filter_.initial_state(), first)
    after = step_state(filter_, before, second)
    assert isinstance(after, TracedCalibration)
    assert after.last_update is not None
    predicted = filter_.propagate(before, second.time_ns, second.ship.correlated_covariance_n)
    np.testing.assert_array_equal(after.last_update.predicted.covariance, predicted.covariance)
    np.testing.assert_array_equal(after.last_update.estimate.mean, after.mean)
    assert after.last_update.is_update
    jump = EncoderJump(second.time_ns + 7, np.array([1e-3, 0.0]), 1e-4)
    inflated = filter_.inflate_covariance(after, jump)
    assert isinstance(inflated, TracedCalibration)
    assert inflated.last_update is not None
    assert inflated.last_update.is_update
    assert inflated.last_update.jumped_ns == jump.time_ns


DRONE = BEACON_PREFIX + "alpha"


@pytest.mark.parametrize("source", [ENCODER, SHIP, TELESCOPE, DRONE])
def test_excluded_axis_sources_are_not_smoothed(source: str) -> None:
    filter_ = TracedFilter(SETTINGS)
    first, second = sightings(2)
    before = step_state(filter_, filter_.initial_state(), first)
    assert isinstance(before, TracedCalibration)
    after = step_state(filter_, with_excluded(before, source), second)
    assert isinstance(after, TracedCalibration)
    assert after.last_update is not None
    assert after.last_update.is_update == (source == DRONE)


def test_an_estimate_without_a_source_leads_nowhere_back() -> None:
    filter_ = TracedFilter(SETTINGS)
    first, second = sightings(2)
    before = step_state(filter_, filter_.initial_state(), first)
    predicted = filter_.propagate(before, second.time_ns, second.ship.correlated_covariance_n)
    comparison = filter_.compare(predicted, second)
    assert comparison is not None
    after, _ = filter_.update_by_beacons(filter_.exclude_source(predicted, DRONE), second, comparison)
    assert isinstance(after, TracedCalibration)
    assert after.last_update is not None
    assert not after.last_update.is_update
