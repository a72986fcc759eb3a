"""Carriers: rates are the derivatives of attitudes; the variance of a spectrum is its integral."""

import numpy as np
import pytest
from scipy.integrate import quad, trapezoid
from scipy.spatial.transform import Rotation

from ship_bags.errors import BadInput
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import log_rotation, wrap_pi
from ship_simulation.scenario.motion_scenario import AngleMotion, CarrierMotion, Sea, Turn, Wave
from ship_simulation.ship.motion import HarmonicMotion, RecordedMotion, SteadyTurn, make_carrier, sea_responses

PAPER = CarrierMotion(
    kind="sinusoids",
    heading=AngleMotion(34.4, {"swell": Wave(0.57, 30.0, 0.0)}),
    pitch=AngleMotion(0.0, {"swell": Wave(1.8, 8.0, 0.0)}),
    roll=AngleMotion(0.0, {"swell": Wave(4.0, 11.0, 0.3)}),
)
STEEP = CarrierMotion(
    kind="sinusoids",
    heading=AngleMotion(300.0, {"a": Wave(20.0, 20.0, 1.0), "b": Wave(3.0, 5.0, -2.0)}),
    pitch=AngleMotion(15.0, {"a": Wave(25.0, 9.0, 0.5)}),
    roll=AngleMotion(-10.0, {"a": Wave(35.0, 7.0, 2.0)}),
    turn=Turn(start_s=10.0, angle_deg=-360.0, rate_deg_per_s=12.0, ramp_s=4.0),
)


def recorded_motion() -> RecordedMotion:
    time_s = np.arange(0.0, 61.0)
    return RecordedMotion(time_s, make_carrier(STEEP, seed=1).attitude(time_s), start_s=2.0)


CARRIERS = {
    "paper": make_carrier(PAPER, seed=1),
    "steep": make_carrier(STEEP, seed=1),
    "sea": make_carrier(CarrierMotion(kind="sea_state"), seed=1),
    "recorded": recorded_motion(),
}


@pytest.mark.parametrize("name", CARRIERS)
def test_body_rate_is_the_derivative_of_the_attitude(name):
    carrier, half_step_s = CARRIERS[name], 1e-3
    # Away from the corners of the turn and the knots of the record, where the second derivative is discontinuous.
    t_s = np.arange(0.1317, 57.0, 0.37)
    turned = np.swapaxes(carrier.attitude(t_s - half_step_s), -1, -2) @ carrier.attitude(t_s + half_step_s)
    differenced = log_rotation(turned) / (2.0 * half_step_s)
    # The error of a central difference is h²/6 times the third derivative, which is below 1 rad/s³ here: 2e-7 rad/s.
    np.testing.assert_allclose(carrier.body_rate(t_s), differenced, rtol=0.0, atol=2e-6)


def test_a_carrier_takes_times_of_any_shape():
    for carrier in CARRIERS.values():
        t_s = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
        assert carrier.attitude(t_s).shape == (2, 3, 3, 3)
        assert carrier.body_rate(t_s).shape == (2, 3, 3)
        np.testing.assert_allclose(carrier.attitude(t_s[1, 2]), carrier.attitude(t_s)[1, 2], rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(carrier.body_rate(t_s[0, 1]), carrier.body_rate(t_s)[0, 1], rtol=0.0, atol=1e-13)


def test_sinusoids_are_those_of_the_formula():
    t_s = np.array([0.0, 3.0, 77.7])
    expected_deg = [
        34.4 + 0.57 * np.sin(2 * np.pi * t_s / 30.0),
        1.8 * np.sin(2 * np.pi * t_s / 8.0),
        4.0 * np.sin(2 * np.pi * t_s / 11.0 + 0.3),
    ]
    angles = angles_from_rotation(CARRIERS["paper"].attitude(t_s))
    np.testing.assert_allclose(np.rad2deg(angles.T), expected_deg, rtol=0.0, atol=1e-12)


def test_a_turn_to_starboard_raises_the_heading_by_its_angle():
    turn = SteadyTurn(start_s=100.0, angle=np.deg2rad(90.0), rate=np.deg2rad(2.0), ramp_s=10.0)
    motion = HarmonicMotion(np.zeros(3), np.zeros(0), np.zeros((0, 3)), [turn])
    t_s = np.array([100.0, 110.0, 127.5, 154.9, 155.0, 1000.0])
    heading_deg = np.rad2deg(angles_from_rotation(motion.attitude(t_s))[:, 0])
    # By hand: the ramp gives 10°, up to 2°/s; then 35 s at 2°/s; half of the angle at 27.5 s; the end after 55 s.
    np.testing.assert_allclose(heading_deg, [0.0, 10.0, 45.0, 90.0 - 0.5 * 0.2 * 0.1**2, 90.0, 90.0], atol=1e-9)
    # Heading increases clockwise seen from above: a negative rotation about Up, the second axis.
    np.testing.assert_allclose(motion.body_rate(np.array(130.0)), [0.0, -np.deg2rad(2.0), 0.0], atol=1e-12)


def test_a_record_is_reproduced_at_its_times_and_not_extrapolated():
    motion = recorded_motion()
    knots_s = np.arange(-2.0, 58.0)
    expected = CARRIERS["steep"].attitude(knots_s + 2.0)
    np.testing.assert_allclose(motion.attitude(knots_s), expected, rtol=0.0, atol=1e-12)
    with pytest.raises(BadInput, match=r"recorded motion lasts 60\.0 s.*reduce duration_s"):
        motion.attitude(np.array([0.0, 58.1]))


def test_a_spline_through_one_sample_a_second_follows_a_rolling_ship():
    t_s = np.arange(0.0, 120.0)
    motion = RecordedMotion(t_s, CARRIERS["paper"].attitude(t_s))
    between_s = np.arange(10.0, 110.0, 0.1)
    error = Rotation.from_matrix(motion.attitude(between_s)).inv() * Rotation.from_matrix(
        CARRIERS["paper"].attitude(between_s)
    )
    # Error of a cubic spline: h⁴/384 times the fourth derivative, 4° (2 pi / 11)⁴ + 1.8° (2 pi / 8)⁴: 0.0029°.
    assert np.rad2deg(error.magnitude().max()) < 0.004


def elevation_spectrum(angular_frequency, significant_height_m, modal_period_s):
    """Return Bretschneider's spectrum of the wave elevation, m² s/rad, one-sided."""
    modal = 2.0 * np.pi / modal_period_s
    ratio4 = (modal / angular_frequency) ** 4
    return 5.0 / 16.0 * significant_height_m**2 * ratio4 / angular_frequency * np.exp(-1.25 * ratio4)


def test_the_variance_of_the_spectrum_is_a_sixteenth_of_the_squared_height():
    variance, _ = quad(lambda w: elevation_spectrum(np.array(w), 3.25, 9.7), 0.05, 60.0, limit=500)
    assert variance == pytest.approx(3.25**2 / 16.0, rel=1e-5)
    w = np.linspace(0.2, 3.0, 100_001)
    assert w[np.argmax(elevation_spectrum(w, 3.25, 9.7))] == pytest.approx(2.0 * np.pi / 9.7, rel=1e-3)


def test_the_ships_response_has_the_variance_of_the_integral_over_the_spectrum():
    sea = Sea()
    modal = 2.0 * np.pi / sea.modal_period_s
    w = np.linspace(0.5 * modal, 4.0 * modal, 20_001)
    spectrum = elevation_spectrum(w, sea.significant_height_m, sea.modal_period_s)
    expected = [trapezoid(spectrum * np.abs(r.transfer(w)) ** 2, w) for r in sea_responses(sea)]
    # The frequencies are random in their bands, so realisations scatter; the mean of 50 scatters a seventh as much.
    motions = [make_carrier(CarrierMotion(kind="sea_state", sea=sea), seed) for seed in range(50)]
    variance = np.mean([0.5 * np.sum(np.abs(m.phasor) ** 2, axis=0) for m in motions], axis=0)
    np.testing.assert_allclose(variance, expected, rtol=0.02)
    # Variance in time: an hour of one realisation, with about 350 waves.
    angles = motions[0].angles(np.arange(0.0, 3600.0, 0.5))
    np.testing.assert_allclose(angles.std(axis=0), np.sqrt(expected), rtol=0.15)


def test_sea_state_5_moves_the_ship_by_degrees():
    angles = wrap_pi(make_carrier(CarrierMotion(kind="sea_state"), seed=3).angles(np.arange(0.0, 600.0, 0.5)))
    heading_deg, pitch_deg, roll_deg = np.rad2deg(angles.std(axis=0))
    assert 0.2 < heading_deg < 1.5
    assert 0.7 < pitch_deg < 2.5
    assert 1.5 < roll_deg < 6.0


def test_beam_waves_roll_and_do_not_pitch():
    sea = make_carrier(CarrierMotion(kind="sea_state", sea=Sea(direction_deg=90.0)), seed=1)
    _, pitch, roll = np.sqrt(np.sum(np.abs(sea.phasor) ** 2, axis=0))
    assert pitch < 1e-12
    assert roll > 0.02


def test_a_sea_does_not_repeat_itself_and_follows_its_seed():
    first, again, other = (make_carrier(CarrierMotion(kind="sea_state"), seed) for seed in (7, 7, 8))
    t_s = np.array([0.0, 12.3])
    np.testing.assert_array_equal(first.attitude(t_s), again.attitude(t_s))
    assert np.abs(first.attitude(t_s) - other.attitude(t_s)).max() > 1e-3
    assert np.unique(np.round(np.diff(first.angular_frequency), 9)).size > 50


def test_attitude_at_rest_is_the_mean():
    still = HarmonicMotion(np.array([1.0, 0.2, -0.3]), np.zeros(0), np.zeros((0, 3)))
    np.testing.assert_allclose(still.attitude(np.array(5.0)), rotation_from_angles(1.0, 0.2, -0.3), atol=1e-15)
    np.testing.assert_array_equal(still.body_rate(np.array(5.0)), np.zeros(3))
