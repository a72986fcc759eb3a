"""Isolation of a step in the pointing from the streams of encoders and ship, after beacons contradicted the
pointing."""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC, exp_rotation
from theodolite_calib.filter.fault_detection import isolate_drift_fault, isolate_step_fault
from theodolite_calib.filter.subfilters import ENCODER, SHIP, TELESCOPE
from theodolite_calib.samples.samples import EncoderSample, ShipSample
from theodolite_calib.samples.stream_consistency import has_ship_drifted, stream_consistency

PERIOD_NS = 50_000_000
SINCE_NS, END_NS = 10 * 10**9, 10_600_000_000
"""Times of the last consistent sighting and of the third inconsistent one."""
BOTH = {ENCODER, SHIP}


def ship_at(seconds, rng):
    """Return a noisy attitude and rates: roll of 4 deg in 11 s, heading of 0.57 deg in 30 s, as in theodolite.yaml."""

    def angles(t):
        return np.radians([4.0 * np.sin(2 * np.pi * t / 11.0), 0.57 * np.sin(2 * np.pi * t / 30.0), 0.0])

    rotation_nd = exp_rotation(angles(seconds))
    ahead = exp_rotation(angles(seconds + 1e-4))
    behind = exp_rotation(angles(seconds - 1e-4))
    turn = behind.T @ ahead
    rate_d = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 4e-4
    return exp_rotation(ARCSEC * rng.standard_normal(3)) @ rotation_nd, rate_d + ARCSEC * rng.standard_normal(3)


def samples(seed, encoder_step=(0.0, 0.0), ship_step_n=(0.0, 0.0, 0.0), rates=True, step_ns=10_120_000_000):
    """Return encoders and ship at 20 Hz from one second before SINCE_NS on, with steps in arcsec at ``step_ns``."""
    rng = np.random.default_rng(seed)
    encoder, ship = [], []
    for time_ns in range(SINCE_NS - 10**9, END_NS + 1, PERIOD_NS):
        is_stepped = time_ns >= step_ns
        t = time_ns * 1e-9
        angles = np.radians([1.2 * t, 40.0 + 30.0 * np.sin(2 * np.pi * t / 110.0)]) + ARCSEC * rng.standard_normal(2)
        encoder.append(EncoderSample(time_ns, angles + is_stepped * ARCSEC * np.array(encoder_step), ARCSEC))
        rotation_nd, rate_d = ship_at(t, rng)
        turned = exp_rotation(is_stepped * ARCSEC * np.array(ship_step_n)) @ rotation_nd
        ship.append(ShipSample(time_ns, turned, rate_d if rates else None))
    return encoder, ship


def check_streams(encoder, ship):
    return stream_consistency(SINCE_NS, encoder, ship, (2 * PERIOD_NS, 2 * PERIOD_NS), ARCSEC)


@pytest.mark.parametrize("rates", [True, False])
@pytest.mark.parametrize(
    ("steps", "off_arcsec", "name"),
    [
        ({"encoder_step": (0.0, 25.0)}, 25.0, ENCODER),
        ({"encoder_step": (-40.0, 0.0)}, 30.0, ENCODER),  # seen at an elevation of 40 deg
        ({"ship_step_n": (0.0, 25.0, 0.0)}, 20.0, SHIP),
        ({"ship_step_n": (18.0, 0.0, -18.0)}, 25.0, SHIP),
        ({}, 25.0, TELESCOPE),
        ({}, 100.0, TELESCOPE),
    ],
)
def test_the_stepped_source_is_named(steps, off_arcsec, name, rates):
    """The result does not depend on the source isolated by the subfilters, because both sources explain the step."""
    named = [
        isolate_step_fault(source, BOTH, check_streams(*samples(seed, rates=rates, **steps)), off_arcsec * ARCSEC)
        for seed in range(20)
        for source in (ENCODER, SHIP)
    ]
    # Without rates the ship's own motion hides steps of few sigmas: the isolated source is kept.
    sure = off_arcsec > 50.0 or rates or name == ENCODER
    allowed = {name} if sure else {name, ENCODER, SHIP}
    assert set(named) <= allowed


@pytest.mark.parametrize("source", [ENCODER, SHIP])
def test_undetectable_step_keeps_the_isolated_source(source):
    assert {isolate_step_fault(source, BOTH, check_streams(*samples(seed)), 5.0 * ARCSEC) for seed in range(20)} == {
        source
    }


def test_degraded_ship_is_isolated_or_no_source():
    encoder, ship = samples(1, encoder_step=(0.0, 25.0))
    degraded = [*ship[:25], replace(ship[25], status=Status.DEGRADED), *ship[26:]]
    gappy = [*ship[:20], *ship[24:]]
    for attitudes in (degraded, gappy):
        streams = check_streams(encoder, attitudes)
        assert isolate_step_fault(ENCODER, BOTH, streams, 25.0 * ARCSEC) == SHIP
        assert isolate_step_fault(ENCODER, {ENCODER}, streams, 25.0 * ARCSEC) is None


def test_stopped_encoders_do_not_implicate_the_telescope():
    """Stuck encoders have no step either, while the beacons move."""
    encoder, ship = samples(1)
    frozen = [*encoder[:22], *(replace(one, vector=encoder[22].vector) for one in encoder[22:])]
    assert isolate_step_fault(ENCODER, BOTH, check_streams(frozen, ship), 100.0 * ARCSEC) == ENCODER
    at_rest = [replace(one, vector=encoder[0].vector) for one in encoder]
    assert isolate_step_fault(ENCODER, BOTH, check_streams(at_rest, ship), 100.0 * ARCSEC) == TELESCOPE


def test_uninformative_streams_keep_the_isolated_source():
    streams = stream_consistency(SINCE_NS, [], [], (PERIOD_NS, PERIOD_NS), ARCSEC)
    assert isolate_step_fault(ENCODER, BOTH, streams, 100.0 * ARCSEC) == ENCODER


def drifting_ship(seed, drift_arcsec_per_s, rates=True, drift_s=20.0):
    """Return a minute of attitudes at 20 Hz that drift about Up for ``drift_s`` from 10 s on, then step back."""
    rng = np.random.default_rng(seed)
    found = []
    for time_ns in range(0, 60 * 10**9, PERIOD_NS):
        rotation_nd, rate_d = ship_at(time_ns * 1e-9, rng)
        since_s = time_ns * 1e-9 - 10.0
        drifted_s = since_s if 0.0 < since_s < drift_s else 0.0
        turned = exp_rotation(drifted_s * drift_arcsec_per_s * ARCSEC * np.array([0.0, 1.0, 0.0])) @ rotation_nd
        found.append(ShipSample(time_ns, turned, rate_d if rates else None))
    return found


def test_drifting_ship_attitude_departs_from_its_rates():
    """Drifts of 20" and 60" with a noise of 1" per attitude and 1"/s per rate."""
    for seed in range(10):
        assert has_ship_drifted(drifting_ship(seed, 1.0), 2 * PERIOD_NS, ARCSEC) is True
        assert has_ship_drifted(drifting_ship(seed, -3.0), 2 * PERIOD_NS, ARCSEC) is True
        assert has_ship_drifted(drifting_ship(seed, 0.0), 2 * PERIOD_NS, ARCSEC) is not True
    assert has_ship_drifted(drifting_ship(0, 0.0), 2 * PERIOD_NS, ARCSEC) is False


@pytest.mark.parametrize("every", [4, 10])
def test_attitudes_that_come_rarely_leave_their_rates_by_the_coarseness_of_the_sum(every):
    """At 5 Hz and 2 Hz the trapezoidal error alone exceeds eight arcseconds: that is no drift."""
    for seed in range(10):
        assert has_ship_drifted(drifting_ship(seed, 0.0)[::every], 2 * every * PERIOD_NS, ARCSEC) is not True


def test_ship_drift_is_unknown_without_rates_or_with_a_gap():
    assert has_ship_drifted(drifting_ship(0, 3.0, rates=False), 2 * PERIOD_NS, ARCSEC) is None
    assert has_ship_drifted(drifting_ship(0, 3.0)[:100] + drifting_ship(0, 3.0)[110:], 2 * PERIOD_NS, ARCSEC) is None
    assert has_ship_drifted([], 2 * PERIOD_NS, ARCSEC) is None


def test_corrected_ship_attitude_is_no_drift():
    sharper = [
        replace(
            sample, correlated_covariance_n=np.eye(3) * ((30.0 if sample.time_ns < 30 * 10**9 else 1.0) * ARCSEC) ** 2
        )
        for sample in drifting_ship(0, 3.0)
    ]
    assert has_ship_drifted(sharper, 2 * PERIOD_NS, ARCSEC) is None


@pytest.mark.parametrize(
    ("source", "explaining", "is_common", "ship", "named"),
    [
        ("beacon.a", {"beacon.a", ENCODER, SHIP}, True, False, ENCODER),
        ("beacon.a", {"beacon.a", ENCODER, SHIP}, True, True, SHIP),
        ("beacon.a", {"beacon.a", ENCODER, SHIP}, True, None, None),
        ("beacon.a", {"beacon.a", ENCODER, SHIP}, False, False, None),
        ("beacon.a", {"beacon.a", SHIP}, False, False, "beacon.a"),  # no ship drift, and encoders do not explain it
        ("beacon.a", {"beacon.a"}, True, True, "beacon.a"),
        (ENCODER, {ENCODER, SHIP}, False, True, SHIP),
        (SHIP, {ENCODER, SHIP}, False, False, ENCODER),
        (SHIP, {ENCODER, SHIP}, False, None, SHIP),
        (SHIP, {SHIP}, True, False, SHIP),
        (None, {ENCODER, SHIP}, False, False, None),
    ],
)
def test_isolation_of_a_drift(source, explaining, is_common, ship, named):
    assert isolate_drift_fault(source, explaining, is_common, ship) == named
