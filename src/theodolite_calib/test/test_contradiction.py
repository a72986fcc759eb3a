"""Who stepped under the theodolite: the streams of encoders and ship, asked where lights contradict them."""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.outcome import Status
from ship_geometry.rotations import ARCSEC, exp_rotation
from theodolite_calib.filter.alternatives import ENCODER, SHIP, TELESCOPE
from theodolite_calib.filter.trust import blamed
from theodolite_calib.measured.contradiction import streams_since
from theodolite_calib.measured.samples import EncoderSample, ShipSample

PERIOD_NS = 50_000_000
SINCE_NS, END_NS = 10 * 10**9, 10_600_000_000
"""Of the last sighting that agreed, and of the third that did not."""
BOTH = {ENCODER, SHIP}


def ship_at(seconds, rng):
    """Roll of 4 deg in 11 s and heading of 0.57 deg in 30 s, as in theodolite.yaml, with noise."""

    def angles(t):
        return np.radians([4.0 * np.sin(2 * np.pi * t / 11.0), 0.57 * np.sin(2 * np.pi * t / 30.0), 0.0])

    rotation_nd = exp_rotation(angles(seconds))
    ahead = exp_rotation(angles(seconds + 1e-4))
    behind = exp_rotation(angles(seconds - 1e-4))
    turn = behind.T @ ahead
    rate_d = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 4e-4
    return exp_rotation(ARCSEC * rng.standard_normal(3)) @ rotation_nd, rate_d + ARCSEC * rng.standard_normal(3)


def samples(seed, encoder_step=(0.0, 0.0), ship_step_n=(0.0, 0.0, 0.0), rates=True, step_ns=10_120_000_000):
    """Both streams at 20 Hz with steps in arcsec, from a second before on."""
    rng = np.random.default_rng(seed)
    encoder, ship = [], []
    for time_ns in range(SINCE_NS - 10**9, END_NS + 1, PERIOD_NS):
        lies = time_ns >= step_ns
        t = time_ns * 1e-9
        angles = np.radians([1.2 * t, 40.0 + 30.0 * np.sin(2 * np.pi * t / 110.0)]) + ARCSEC * rng.standard_normal(2)
        encoder.append(EncoderSample(time_ns, angles + lies * ARCSEC * np.array(encoder_step), ARCSEC))
        rotation_nd, rate_d = ship_at(t, rng)
        turned = exp_rotation(lies * ARCSEC * np.array(ship_step_n)) @ rotation_nd
        ship.append(ShipSample(time_ns, turned, rate_d if rates else None))
    return encoder, ship


def told(encoder, ship):
    return streams_since(SINCE_NS, encoder, ship, (2 * PERIOD_NS, 2 * PERIOD_NS), ARCSEC)


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
def test_who_stepped_is_named(steps, off_arcsec, name, rates):
    """Whatever the rows have it: both explain it."""
    named = [
        blamed(rows, BOTH, told(*samples(seed, rates=rates, **steps)), off_arcsec * ARCSEC)
        for seed in range(20)
        for rows in (ENCODER, SHIP)
    ]
    # Without rates the ship's own motion hides steps of so few sigmas: then what the rows say may stand.
    sure = off_arcsec > 50.0 or rates or name == ENCODER
    allowed = {name} if sure else {name, ENCODER, SHIP}
    assert set(named) <= allowed


@pytest.mark.parametrize("rows", [ENCODER, SHIP])
def test_what_is_too_small_to_be_seen_in_the_streams_stays_as_the_rows_have_it(rows):
    assert {blamed(rows, BOTH, told(*samples(seed)), 5.0 * ARCSEC) for seed in range(20)} == {rows}


def test_a_ship_that_was_in_doubt_itself_is_blamed_or_nobody():
    encoder, ship = samples(1, encoder_step=(0.0, 25.0))
    doubtful = [*ship[:25], replace(ship[25], status=Status.DEGRADED), *ship[26:]]
    gappy = [*ship[:20], *ship[24:]]
    for attitudes in (doubtful, gappy):
        streams = told(encoder, attitudes)
        assert blamed(ENCODER, BOTH, streams, 25.0 * ARCSEC) == SHIP
        assert blamed(ENCODER, {ENCODER}, streams, 25.0 * ARCSEC) is None


def test_encoders_that_stopped_dead_are_not_believed_against_the_telescope():
    """Frozen encoders make no step either; the lights move on without them."""
    encoder, ship = samples(1)
    frozen = [*encoder[:22], *(replace(one, vector=encoder[22].vector) for one in encoder[22:])]
    assert blamed(ENCODER, BOTH, told(frozen, ship), 100.0 * ARCSEC) == ENCODER
    at_rest = [replace(one, vector=encoder[0].vector) for one in encoder]
    assert blamed(ENCODER, BOTH, told(at_rest, ship), 100.0 * ARCSEC) == TELESCOPE


def test_streams_that_tell_nothing_leave_what_the_rows_say():
    streams = streams_since(SINCE_NS, [], [], (PERIOD_NS, PERIOD_NS), ARCSEC)
    assert blamed(ENCODER, BOTH, streams, 100.0 * ARCSEC) == ENCODER
