"""[Z14]'s fifteen conclusions and thirty-one factors against the exact model, in both readings of its installation."""

import numpy as np
import pytest

from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import wrap_pi
from ship_studies.layout.installation_model import InstallationConvention, ship_rotation
from tools.papers.z14 import upright_attitudes
from tools.papers.z14_conclusions import (
    ABEAM,
    AHEAD_ASTERN,
    CONCLUSIONS,
    HEADING,
    PITCH,
    ROLL,
    curve_arcsec,
    is_falling,
    is_falling_then_growing,
    is_growing,
    is_oscillating,
)
from tools.papers.z14_factors import (
    ANGLES,
    FACTORS,
    exact_jacobian,
    jacobian_of_factors,
    largest_difference,
    random_attitudes,
)

PAPER, PHYSICAL = InstallationConvention.PAPER, InstallationConvention.PHYSICAL
HOLD_PHYSICALLY = {"3.1 (2)", "3.2 (1)", "3.2 (4)", "3.3 (1)", "3.3 (3)"}
MISPRINTED, LOST = {12}, {16, 17, 23}


@pytest.mark.parametrize("conclusion", CONCLUSIONS, ids=lambda each: each.holds.__name__)
def test_a_conclusion_holds_in_the_readings_of_the_page(conclusion):
    assert conclusion.holds(PAPER)
    assert conclusion.holds(PHYSICAL) == (conclusion.place in HOLD_PHYSICALLY)


def test_there_are_as_many_conclusions_as_in_the_paper():
    counts = {"3.1": 4, "3.2": 7, "3.3": 4}
    places = [f"{section} ({number})" for section, count in counts.items() for number in range(1, count + 1)]
    assert [conclusion.place for conclusion in CONCLUSIONS] == places
    assert len({conclusion.holds for conclusion in CONCLUSIONS}) == 15
    assert all(conclusion.remark for conclusion in CONCLUSIONS if conclusion.place not in HOLD_PHYSICALLY)


@pytest.mark.parametrize("reading", InstallationConvention)
@pytest.mark.parametrize(("figure", "turn_back_arcsec"), [(3, 1e-9), (6, 8.0)])
def test_roll_does_not_grow_with_elevation_as_in_the_abstracts(reading, figure, turn_back_arcsec):
    """Both abstracts state that roll grows abeam.

    For sensors along the keel, the English abstract states that roll grows, the Chinese abstract that heading grows.
    """
    for azimuth_deg in (*AHEAD_ASTERN, *ABEAM):
        roll = curve_arcsec(figure, azimuth_deg, reading)[:, ROLL]
        assert not is_growing(roll, turn_back_arcsec)
        assert roll[-1] <= roll[0] + 1.0
    for azimuth_deg in AHEAD_ASTERN:
        sizes = curve_arcsec(figure, azimuth_deg, reading)
        assert is_growing(sizes[:, HEADING], turn_back_arcsec)
        assert sizes[-1, ROLL] < 0.3 * sizes[0, ROLL]


def test_trends():
    up, there_and_back = np.array([1.0, 3.0, 2.5, 9.0]), np.array([9.0, 1.0, 9.0])
    assert is_growing(up, 0.6)
    assert not is_growing(up, 0.4)
    assert not is_growing(np.array([1.0, 1.5]), 0.6)
    assert is_falling(up[::-1], 0.6)
    assert not is_falling(up, 0.6)
    assert is_falling_then_growing(there_and_back, 1.0)
    assert not is_falling_then_growing(up, 0.6)
    assert not is_falling_then_growing(np.array([9.0, 1.0, 1.5]), 1.0)
    assert is_oscillating(there_and_back - np.array([0.0, 0.9, 0.0]))
    assert not is_oscillating(np.array([9.0, 9.0, 9.0]))
    bad = np.array([1.0, np.nan, 9.0])
    assert not is_growing(bad, 8.0)
    assert not is_falling(bad, 8.0)
    assert not is_oscillating(bad)


def test_numbers_that_the_remarks_name():
    """Physical reading: figures 3 and 6 abeam, figure 5 ahead, figure 6 astern. Paper's reading: figure 3 abeam."""
    assert curve_arcsec(3, 90.0, PAPER)[0, HEADING] == pytest.approx(141.42, abs=0.005)
    abeam = curve_arcsec(3, 90.0, PHYSICAL)
    np.testing.assert_allclose(abeam, np.tile([141.42, 0.0, 100.0], (91, 1)), atol=0.005)
    np.testing.assert_allclose(curve_arcsec(5, 0.0, PHYSICAL)[[0, -1], HEADING], [273.0, 44.6], atol=0.05)
    for azimuth_deg in (90.0, 270.0):
        both = curve_arcsec(6, azimuth_deg, PHYSICAL)
        assert np.ptp(both[:, [HEADING, ROLL]], axis=0).max() < 2.0
        assert both[:, PITCH].max() < 4.001
    astern = curve_arcsec(6, 180.0, PHYSICAL)[:, ROLL]
    assert int(np.argmin(astern)) == 86
    assert astern[-1] - astern.min() == pytest.approx(3.0, abs=0.5)


@pytest.mark.parametrize("factor", FACTORS, ids=lambda factor: f"{factor.number}_{factor.symbol}")
def test_a_factor_is_the_exact_one_or_an_erratum(factor):
    difference = largest_difference(factor, random_attitudes(1000))
    if factor.number in LOST:
        assert np.isnan(difference)
    elif factor.number in MISPRINTED:
        assert difference > 1.0
    else:
        assert difference < 1e-13


def test_every_factor_is_there():
    assert [factor.number for factor in FACTORS] == list(range(8, 39))


DERIVATIVES = [factor for factor in FACTORS if factor.by]


@pytest.mark.parametrize("factor", DERIVATIVES, ids=lambda factor: f"{factor.number}_{factor.symbol}")
def test_an_exact_factor_is_the_derivative(factor):
    """The derivative is computed by central differences of the rotation's element."""
    angles, step = random_attitudes(200), 1e-5
    moved = step * np.eye(6)[ANGLES.index(factor.by)]
    row, column = {"N_K": (2, 0), "D_K": (0, 0), "S": (1, 0), "N_θ": (1, 2), "D_θ": (1, 1)}[factor.element]
    ends = [ship_rotation(each[:, :3], each[:, 3:], PAPER)[:, row, column] for each in (angles + moved, angles - moved)]
    sign = factor.sign * (-1.0 if factor.element == "N_θ" else 1.0)
    np.testing.assert_allclose(factor.exact(angles), sign * (ends[0] - ends[1]) / (2.0 * step), atol=1e-9)


def test_the_factors_joined_are_the_exact_jacobian_in_the_papers_reading_alone():
    angles = upright_attitudes(PHYSICAL)
    assert len(angles) > 900
    joined = jacobian_of_factors(angles)
    np.testing.assert_allclose(joined, exact_jacobian(angles, PAPER), atol=1e-12)
    assert np.max(np.abs(joined - exact_jacobian(angles, PHYSICAL))) > 1.0


def test_the_factors_joined_are_differences_of_the_ships_angles():
    angles, step = upright_attitudes(PAPER), 1e-6
    joined = jacobian_of_factors(angles)
    for column in range(6):
        moved = step * np.eye(6)[column]
        rotations = (ship_rotation(each[:, :3], each[:, 3:], PAPER) for each in (angles + moved, angles - moved))
        ends = [angles_from_rotation(rotation) for rotation in rotations]
        np.testing.assert_allclose(joined[:, :, column], wrap_pi(ends[0] - ends[1]) / (2.0 * step), atol=1e-6)
