"""The pointing that is put out: a function of state, ship and encoders that takes one moment or a stack of them."""

import numpy as np
import pytest

from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_testing.simulated_session import config, session, sweep
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.measured.samples import Exposure
from theodolite_calib.measured.tracks import EncoderAt, ShipAt
from theodolite_calib.optical_axis.output import CorrectedAxis

TIMES_S = np.arange(0.0, 10.0)


@pytest.mark.parametrize("source", ["ship/attitude", "ins/imu"])
def test_a_stack_of_moments_gives_what_the_single_calls_give(source: str) -> None:
    settings = config(ship__source=source)
    filter_ = CalibrationFilter(settings)
    state, step = filter_.initial_state(), SightingStep(settings, filter_)
    for sighting in session(settings, 4, TIMES_S, sweep(TIMES_S)).sightings:
        state, _ = step(state, sighting, Exposure(sighting.time_ns, ()))
    assert state.used_ns is not None
    rng, count = np.random.default_rng(5), 7
    since_s = np.concatenate([[0.0], rng.uniform(0.0, 100.0, count - 1)])
    # Stars have gone: the ship's error grows at once.
    stated_n = None if source == "ins/imu" else (ARCSEC * np.diag([3.0, 20.0, 3.0])) ** 2
    rotation_nd, rate_d = exp_rotation(rng.standard_normal((count, 3))), 0.1 * rng.standard_normal((count, 3))
    stack = ShipAt(rotation_nd, rate_d, stated_n, rng.uniform(1e-12, 1e-10, count))
    encoders = EncoderAt(rng.uniform(0.0, 6.0, count), rng.uniform(0.1, 1.0, count), rng.uniform(1e-12, 1e-10, count))
    corrected = CorrectedAxis(filter_, state)
    axes = corrected.at(since_s, stack, encoders)
    for row in range(count):
        ship = ShipAt(stack.rotation_nd[row], stack.rate_d[row], stated_n, float(stack.noise[row]))
        encoder = EncoderAt(*(float(value[row]) for value in (encoders.azimuth, encoders.elevation, encoders.noise)))
        one = corrected.at(float(since_s[row]), ship, encoder)
        assert axes.rotation_nm[row] == pytest.approx(one.rotation_nm, abs=1e-15)
        assert axes.rotation_nt[row] == pytest.approx(one.rotation_nt, abs=1e-15)
        assert axes.parts_n[row] == pytest.approx(one.parts_n, rel=1e-12, abs=1e-24)
