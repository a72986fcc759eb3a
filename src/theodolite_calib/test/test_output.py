"""Pointing as a function of state, ship and encoders, for one time or many."""

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.fault_detection.exclusion import UnresolvedFault
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import axis_geometry
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_testing.simulated_session import config, session, sweep
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import axis_state_indices
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.optical_axis.output import CorrectedAxis, PendingPointing, PointingOutput, PointingSeries
from theodolite_calib.samples.samples import (
    EncoderSample,
    Exposure,
    Mode,
    PointingEstimate,
)
from theodolite_calib.samples.tracks import ShipAt

TIMES_S = np.arange(0.0, 10.0)
COUNT = 12
LIMITS_ARCSEC = (620.0, 450.0, 2000.0)
"""Alert limits that some of the pointings exceed."""
SOURCES = ["ship/attitude", "ins/imu"]


@functools.cache
def state_after_beacons(source: str) -> tuple[OpticalAxisConfig, CalibrationFilter, CalibrationState]:
    """Return a configuration, its filter, and the state after ten seconds of beacons."""
    settings = config(ship__source=source, integrity__alert_limit_arcsec=LIMITS_ARCSEC)
    filter_ = CalibrationFilter(settings)
    state, step = filter_.initial_state(), SightingStep(settings, filter_)
    for sighting in session(settings, 4, TIMES_S, sweep(TIMES_S)).sightings:
        state, _ = step(state, sighting, Exposure(sighting.time_ns, ()))
    assert state.last_beacons_ns is not None
    return settings, filter_, state


def readings(source: str, state: CalibrationState) -> list[PendingPointing]:
    """Return readings from the state's time until long after the beacons, some of them unconfirmed."""
    rng = np.random.default_rng(5)
    assert state.time_ns is not None
    since_ns = np.concatenate([[0], np.sort(rng.integers(1, 8 * 10**9, COUNT - 1))])
    angles = np.stack([rng.uniform(0.0, 6.0, COUNT), rng.uniform(0.1, 1.0, COUNT)], axis=-1)
    sigma_rad = np.sqrt(rng.uniform(1e-12, 1e-10, COUNT))
    # The ship's stated error changes in steps, as after a loss and a return of stars.
    sizes = np.resize([1.0, 1.1, 3.0, 0.2], COUNT)[:, None, None]
    root = np.diag([1.4, 1.8, 1.4]) + 0.2 * rng.standard_normal((COUNT, 3, 3))
    stated_n = (ARCSEC * sizes) ** 2 * (root @ root.swapaxes(1, 2))
    rotation_nd, rate_d = exp_rotation(rng.standard_normal((COUNT, 3))), 0.1 * rng.standard_normal((COUNT, 3))
    ship_noise = rng.uniform(1e-12, 1e-10, COUNT)
    chord_nd = rotation_nd @ exp_rotation(1e-3 * rng.standard_normal((COUNT, 3)))
    by_ins = source == "ins/imu"
    return [
        PendingPointing(
            EncoderSample(state.time_ns + int(since_ns[k]), angles[k], 0.8 * sigma_rad[k]),
            ShipAt(
                rotation_nd[k],
                rate_d[k],
                None if by_ins else stated_n[k],
                ship_noise[k],
                Status.DEGRADED if k % 4 == 3 else Status.VALID,
                None if by_ins else chord_nd[k],
            ),
            "the encoders stopped during a motion" if k % 3 == 2 else "",
            0.6 * sigma_rad[k],
            state,
        )
        for k in range(COUNT)
    ]


@pytest.mark.parametrize("source", SOURCES)
def test_axis_equals_that_of_the_predicted_state(source: str) -> None:
    """The filter propagates the whole state to each time; numpy computes the axis geometry from it."""
    _, filter_, state = state_after_beacons(source)
    index, rows = filter_.model.sources.index, axis_state_indices(filter_.model)
    pending = readings(source, state)
    axes = CorrectedAxis(filter_, state).axes(pending)
    for number, (sample, ship, _, unconfirmed_sigma_rad, _) in enumerate(pending):
        later = filter_.propagate(state, sample.time_ns, ship.correlated_covariance_n)
        errors = filter_.sightings.geometry_errors(later.mean)
        geometry = axis_geometry(errors, ship.rotation_nd, ship.rate_d, *sample.vector.tolist())
        by_error = geometry.by_error[:, : len(rows)]
        parts_n = by_error @ later.covariance_by_source[:, rows[:, None], rows] @ by_error.T
        variance = sample.sigma**2 + unconfirmed_sigma_rad**2
        parts_n[index("encoder")] += variance * geometry.by_encoder @ geometry.by_encoder.T
        parts_n[index("ship_noise")] += ship.noise * np.eye(3)
        np.testing.assert_allclose(axes.rotation_nm[number], geometry.rotation_nm, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(axes.by_error_n[number], by_error, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(axes.covariance_by_source_n[number], parts_n, rtol=0.0, atol=1e-13 * np.max(parts_n))


def with_unresolved_fault(state: CalibrationState) -> CalibrationState:
    """Return the state with an unresolved fault and separated subfilters."""
    conflict = UnresolvedFault("", (3.0 * ARCSEC) ** 2 * np.diag([1.0, 2.0, 3.0]))
    fault_state = replace(state.fault_state, unresolved_fault=conflict)
    return replace(state, fault_state=fault_state, solution_separation=np.full(len(state.solution_separation), 5.0))


def assert_same_bits(found: PointingEstimate, expected: PointingEstimate) -> None:
    for name, value in vars(found).items():
        one = getattr(expected, name)
        same = value.tobytes() == one.tobytes() if isinstance(value, np.ndarray) else value == one
        assert same or value is one, name


@pytest.mark.parametrize("is_unresolved", [False, True])
@pytest.mark.parametrize("source", SOURCES)
def test_a_reading_gives_to_the_bit_what_it_gives_among_others(source: str, is_unresolved: bool) -> None:
    settings, filter_, state = state_after_beacons(source)
    state, output = with_unresolved_fault(state) if is_unresolved else state, PointingOutput(settings, filter_)
    pending = readings(source, state)
    run = output.series(pending)
    assert set(run.mode.tolist()) == {Mode.TWO_LIGHTS, Mode.ENCODER}
    if not is_unresolved:
        assert len(set(run.status)) > 1
        assert len(set(run.text)) > 2
    for number, reading in enumerate(pending):
        assert_same_bits(run.estimate(number), output.estimate(reading))


@pytest.mark.parametrize("source", SOURCES)
def test_beacon_outputs_are_valid_while_recent(source: str) -> None:
    settings, filter_, before = state_after_beacons(source)
    state = with_unresolved_fault(before)
    pending = readings(source, state)
    run = PointingOutput(settings, filter_).series(pending)
    recent = run.mode == Mode.TWO_LIGHTS
    assert np.isfinite(run.rotation_nt).all(axis=(1, 2)).tolist() == recent.tolist()
    parallelism = rotation_from_angles(*filter_.sightings.parallelism(state.mean))
    np.testing.assert_allclose(run.rotation_nt[recent] @ parallelism, run.rotation_nm[recent], rtol=0.0, atol=1e-15)
    assert run.light_count.tolist() == np.where(recent, 2, 0).tolist()
    np.testing.assert_allclose(run.covariance_by_source_n.sum(axis=1), run.covariance_n, rtol=1e-12)
    more = np.trace(run.covariance_n - run.covariance_without_separation_n, axis1=1, axis2=2)
    assert (more > 0.0).tolist() == recent.tolist()
    if source == "ins/imu":
        assert np.isnan(run.rotation_dm).all()
    else:
        chords_nd = np.array([reading.ship.chord_nd for reading in pending])
        np.testing.assert_allclose(chords_nd @ run.rotation_dm, run.rotation_nm, rtol=0.0, atol=1e-14)


def test_pending_pointings_equal_those_computed_at_once_and_one_that_fails_fails_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings, filter_, state = state_after_beacons("ins/imu")
    later, output = replace(state, consecutive_rejections=1), PointingOutput(settings, filter_)
    pending = readings("ins/imu", state)[:9]
    pending[5:] = [reading._replace(state=later) for reading in pending[5:]]
    runs = output.compute_pending(pending)
    assert [some for some, _ in runs] == [slice(0, 5), slice(5, 9)]
    for some, run in runs:
        assert isinstance(run, PointingSeries)
        for number, one in enumerate(pending[some]):
            assert_same_bits(run.estimate(number), output.estimate(one))
    series, odd = output.series, pending[6]

    def failing(given: Sequence[PendingPointing]) -> PointingSeries:
        if any(reading is odd for reading in given):
            raise ValueError("no number")
        return series(given)

    monkeypatch.setattr(output, "series", failing)
    found = output.compute_pending(pending)
    assert [some for some, _ in found] == [slice(0, 5), *(slice(number, number + 1) for number in range(5, 9))]
    assert [isinstance(run, PointingSeries) for _, run in found] == [True, True, False, True, True]
