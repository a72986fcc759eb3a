"""From the telescope to the main axis."""

import numpy as np
import pytest

from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC, log_rotation
from ship_testing.simulated_sightings import truth_of
from theodolite_calib.chain.parallelism import Parallelism, main_from_telescope

EXACT = Parallelism(np.deg2rad([0.3, -0.2, 0.5]), np.zeros((3, 3)))


@pytest.mark.parametrize("elevation_deg", [-5.0, 30.0, 70.0])
@pytest.mark.parametrize("rotation_deg", [0.0, 40.0, 130.0, -120.0, 180.0])
def test_first_order_of_the_models_page(elevation_deg, rotation_deg):
    # A_j = A + (ΔA cos ω + ΔE sin ω) sec E, E_j = E + ΔE cos ω - ΔA sin ω
    small = Parallelism(np.array([40.0, -30.0, 20.0]) * ARCSEC, np.zeros((3, 3)))
    telescope = truth_of(123.0, elevation_deg, rotation_deg).rotation_nt
    rotation_nm, _ = main_from_telescope(small, telescope, {})
    azimuth, elevation, _ = angles_from_rotation(rotation_nm) - angles_from_rotation(telescope)
    d_a, d_e, omega = small.angles[0], small.angles[1], np.deg2rad(rotation_deg)
    expected = (d_a * np.cos(omega) + d_e * np.sin(omega)) / np.cos(np.deg2rad(elevation_deg))
    assert azimuth / ARCSEC == pytest.approx(expected / ARCSEC, abs=0.05)
    assert elevation / ARCSEC == pytest.approx((d_e * np.cos(omega) - d_a * np.sin(omega)) / ARCSEC, abs=0.05)


def test_composition_is_exact_and_regular_at_the_zenith():
    telescope = truth_of(50.0, 90.0, 20.0).rotation_nt
    rotation_nm, _ = main_from_telescope(EXACT, telescope, {})
    assert telescope.T @ rotation_nm == pytest.approx(rotation_from_angles(*EXACT.angles), abs=1e-15)


def test_rotation_vector_of_the_telescope_is_that_of_the_main_axis():
    part = np.diag([1.0, 2.0, 3.0]) * ARCSEC**2
    _, parts = main_from_telescope(EXACT, truth_of(50.0, 20.0, 20.0).rotation_nt, {"rtk": part})
    assert parts["rtk"] == pytest.approx(part)
    assert np.abs(parts["parallelism"]).max() == 0.0


def test_uncertainty_of_the_angles_by_chance():
    count, telescope = 20_000, truth_of(50.0, 35.0, -70.0).rotation_nt
    root = np.array([[20.0, 0.0, 0.0], [5.0, 10.0, 0.0], [-8.0, 3.0, 40.0]]) * ARCSEC
    uncertain = Parallelism(np.deg2rad([0.3, -0.2, 0.5]), root @ root.T)
    rotation_nm, parts = main_from_telescope(uncertain, telescope, {})
    angles = uncertain.angles + np.random.default_rng(5).standard_normal((count, 3)) @ root.T
    true = telescope @ rotation_from_angles(*angles.T)
    error = log_rotation(true @ rotation_nm.T)
    sigma = np.sqrt(np.diag(parts["parallelism"]))
    sample = error.T @ error / count / np.outer(sigma, sigma)
    assert sample == pytest.approx(parts["parallelism"] / np.outer(sigma, sigma), abs=4.0 * np.sqrt(2.0 / count))


def test_many_at_once():
    telescope = truth_of(np.array([0.0, 90.0]), 35.0, -70.0).rotation_nt
    uncertain = Parallelism(EXACT.angles, ARCSEC**2 * np.diag([1.0, 4.0, 9.0]))
    rotation_nm, parts = main_from_telescope(uncertain, telescope, {})
    alone, alone_parts = main_from_telescope(uncertain, telescope[1], {})
    assert rotation_nm[1] == pytest.approx(alone, abs=1e-15)
    assert parts["parallelism"][1] == pytest.approx(alone_parts["parallelism"], abs=1e-24)
