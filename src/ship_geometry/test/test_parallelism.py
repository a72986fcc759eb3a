"""Telescope attitude from the main axis."""

import numpy as np
import pytest

from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.mount.axes import telescope_rotation
from ship_geometry.rotations import ARCSEC, log_rotation
from ship_testing.simulated_sightings import truth_of

ANGLES = np.deg2rad([0.3, -0.2, 0.5])


@pytest.mark.parametrize("elevation_deg", [-5.0, 30.0, 70.0])
@pytest.mark.parametrize("rotation_deg", [0.0, 40.0, 130.0, -120.0, 180.0])
def test_first_order_of_the_models_page(elevation_deg, rotation_deg):
    # A_j = A + (ΔA cos ω + ΔE sin ω) sec E, E_j = E + ΔE cos ω - ΔA sin ω
    small = np.array([40.0, -30.0, 20.0]) * ARCSEC
    telescope = truth_of(123.0, elevation_deg, rotation_deg).rotation_nt
    main = telescope @ rotation_from_angles(*small)
    azimuth, elevation, _ = angles_from_rotation(main) - angles_from_rotation(telescope_rotation(small, main)[0])
    d_a, d_e, omega = small[0], small[1], np.deg2rad(rotation_deg)
    expected = (d_a * np.cos(omega) + d_e * np.sin(omega)) / np.cos(np.deg2rad(elevation_deg))
    assert azimuth / ARCSEC == pytest.approx(expected / ARCSEC, abs=0.05)
    assert elevation / ARCSEC == pytest.approx((d_e * np.cos(omega) - d_a * np.sin(omega)) / ARCSEC, abs=0.05)


def test_composition_is_exact_and_regular_at_the_zenith():
    main = truth_of(50.0, 90.0, 20.0).rotation_nt
    telescope, _ = telescope_rotation(ANGLES, main)
    assert telescope.T @ main == pytest.approx(rotation_from_angles(*ANGLES), abs=1e-15)


@pytest.mark.parametrize("elevation_deg", [35.0, 90.0])
def test_turn_of_the_telescope_by_each_angle(elevation_deg):
    main, step = truth_of(50.0, elevation_deg, -70.0).rotation_nt, 1e-5
    _, by_angles = telescope_rotation(ANGLES, main)
    for column, change in enumerate(step * np.eye(3)):
        after, before = (telescope_rotation(ANGLES + sign * change, main)[0] for sign in (0.5, -0.5))
        assert log_rotation(after @ before.T) / step == pytest.approx(by_angles[:, column], abs=1e-8)
