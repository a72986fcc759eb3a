"""The layout study: the engineering rule, the recommended azimuths, the six figures."""

from itertools import combinations
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_studies.layout.config import OperatingPoint, study_config
from ship_studies.layout.error_budget import Layout, error_map, total_arcsec
from ship_studies.layout.figures import plan_figure
from ship_studies.layout.installation_model import SWEEPS, Curve, InstallationConvention, all_curves, linearise
from ship_studies.layout.study import compute_study, recommend_azimuths, scan_azimuth

ONLY_BORESIGHT = {
    "sigma_up_arcsec": 0.001,
    "sigma_right_arcsec": 0.001,
    "installation_sigma_forward_arcsec": 0.0,
    "installation_sigma_up_arcsec": 0.0,
    "installation_sigma_right_arcsec": 0.0,
}


def layout_of(*sensors: dict[str, float], **others: Any) -> Layout:
    named = {f"sensor_{number}": sensor for number, sensor in enumerate(sensors)}
    return Layout.from_config(study_config({"sensors": named, **others}))


def sensor(azimuth_deg: float, elevation_deg: float = 35.0, **others: float) -> dict[str, float]:
    return {"azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg, **others}


@pytest.mark.parametrize("roll_deg", [0.0, 90.0, -30.0])
@pytest.mark.parametrize(
    ("azimuth_deg", "pitch_share", "roll_share"), [(0.0, 0, 1), (180.0, 0, 1), (90.0, 1, 0), (270.0, 1, 0)]
)
def test_rule_for_a_level_ship(azimuth_deg: float, pitch_share: int, roll_share: int, roll_deg: float) -> None:
    """models.md §3: boresight error times sin E0 goes into heading, times cos E0 into roll (ahead) or pitch (abeam)."""
    layout = layout_of(sensor(azimuth_deg, 35.0, roll_deg=roll_deg, **ONLY_BORESIGHT))
    sine, cosine = np.sin(np.deg2rad(35.0)), np.cos(np.deg2rad(35.0))
    expected = 100.0 * np.array([sine, pitch_share * cosine, roll_share * cosine])
    np.testing.assert_allclose(layout.sigmas_arcsec(), expected, atol=0.01)


def test_one_sensor_agrees_with_the_angles_of_the_error_model() -> None:
    """Errors about the sensor's own axes, propagated by J_s of [Z14]'s angles, on a ship that is not level."""
    own = sensor(37.0, 50.0, roll_deg=20.0, sigma_forward_arcsec=100.0, sigma_up_arcsec=3.0, sigma_right_arcsec=5.0)
    layout = layout_of({**own, **{k: 0.0 for k in ONLY_BORESIGHT if "installation" in k}}, ship_pitch_deg=8.0)
    rotation_ns = rotation_from_angles(*layout.ship_angles) @ rotation_from_angles(*layout.angles[0])
    star = angles_from_rotation(rotation_ns)
    step = 1e-6
    # Columns: numerical derivatives of the sensor's horizon angles with respect to rotations about the sensor's axes.
    turned = [
        angles_from_rotation(rotation_ns @ (np.eye(3) + step * np.cross(axis, np.eye(3)).T)) for axis in np.eye(3)
    ]
    answers = (np.array(turned) - star).T / step
    star_covariance = answers @ np.diag([100.0, 3.0, 5.0]) ** 2 @ answers.T
    by_star = linearise(star, layout.angles[0]).star
    covariance = by_star @ star_covariance @ by_star.T
    np.testing.assert_allclose(layout.sigmas_arcsec(), np.sqrt(np.diag(covariance)), rtol=1e-4)


def test_two_sensors_at_right_angles_complement_each_other() -> None:
    alone = layout_of(sensor(0.0)).sigmas_arcsec()
    together = layout_of(sensor(0.0), sensor(90.0)).sigmas_arcsec()
    assert alone.max() > 80.0
    # The joint error is of the size of the well measured components: 3″ of noise and 1″ of installation.
    assert together.max() < 4.0


def test_parallel_sensors_do_not_complement_each_other() -> None:
    together = layout_of(sensor(20.0), sensor(20.0)).sigmas_arcsec()
    np.testing.assert_allclose(together, layout_of(sensor(20.0)).sigmas_arcsec() / np.sqrt(2.0), rtol=1e-9)


def test_budget_adds_up_to_the_joint_error() -> None:
    common = {"heading_sigma_arcsec": 1.0, "tilt_sigma_arcsec": 0.5, "refraction_sigma_arcsec": 2.0}
    layout = layout_of(sensor(0.0), sensor(100.0, 55.0), sensor(200.0, 20.0), common=common, ship_roll_deg=5.0)
    budget = layout.budget()
    squares = sum(source.errors_arcsec**2 for source in budget)
    np.testing.assert_allclose(np.sqrt(squares), layout.sigmas_arcsec(), rtol=1e-9)
    assert len(budget) == 3 * 6 + 4


def test_common_errors_do_not_average_away() -> None:
    common = {"heading_sigma_arcsec": 2.0}
    without = layout_of(sensor(0.0), sensor(90.0)).sigmas_arcsec()
    with_common = layout_of(sensor(0.0), sensor(90.0), common=common).sigmas_arcsec()
    np.testing.assert_allclose(with_common**2 - without**2, [4.0, 0.0, 0.0], atol=1e-9)


def test_refraction_raises_every_star() -> None:
    """models.md §2: at 45° a refraction error raises the sensor by its size: pitch error ahead, roll error abeam."""
    sharp = {**ONLY_BORESIGHT, "sigma_forward_arcsec": 0.001}
    for azimuth_deg, expected in ((0.0, [0.0, 0.6, 0.0]), (90.0, [0.0, 0.0, 0.6])):
        one = layout_of(sensor(azimuth_deg, 45.0, **sharp), common={"refraction_sigma_arcsec": 0.6})
        np.testing.assert_allclose(one.sigmas_arcsec(), expected, atol=0.003)


def test_recommended_azimuth_is_a_right_angle_in_space() -> None:
    """Equal sensors at elevation E are at right angles for cos(azimuth) = -tan² E: 119.4° at 35°."""
    given = layout_of(sensor(0.0), sensor(90.0))
    best = recommend_azimuths(given)
    assert np.rad2deg(best.angles[:, 0]) == pytest.approx([0.0, 119.4], abs=0.5)
    assert total_arcsec(best.sigmas_arcsec()) < total_arcsec(given.sigmas_arcsec())
    low, high = scan_azimuth(best, 1).good_deg or (0.0, 0.0)
    assert 70.0 < low < 90.0
    assert high == pytest.approx(360.0 - low, abs=1.0)


def test_no_random_layout_is_clearly_better_than_the_recommended_one() -> None:
    given = layout_of(sensor(0.0, 30.0), sensor(90.0, 50.0), sensor(180.0, 20.0, sigma_forward_arcsec=40.0))
    angles = np.tile(given.angles, (3000, 1, 1))
    angles[:, 1:, 0] = np.random.default_rng(8).uniform(0.0, 2.0 * np.pi, (3000, 2))
    at_random = total_arcsec(given.sigmas_arcsec(angles)).min()
    assert total_arcsec(recommend_azimuths(given).sigmas_arcsec()) < 1.03 * at_random


def test_map_contains_the_layout_itself() -> None:
    layout = layout_of(sensor(0.0), sensor(90.0, 40.0))
    moved = error_map(layout, 1)
    row, column = np.searchsorted(moved.elevations_deg, 40.0), np.searchsorted(moved.azimuths_deg, 90.0)
    np.testing.assert_allclose(moved.sigmas_arcsec[row, column], layout.sigmas_arcsec(), rtol=1e-12)
    # Largest where both boresights are parallel.
    totals = total_arcsec(moved.sigmas_arcsec)
    row, column = np.unravel_index(np.argmax(totals), totals.shape)
    assert moved.elevations_deg[row] == 35.0
    assert moved.azimuths_deg[column] % 360.0 == 0.0


def test_map_of_a_heeled_ship_omits_directions_below_the_horizon() -> None:
    layout = layout_of(sensor(270.0, 60.0), sensor(0.0, 60.0), ship_roll_deg=30.0)
    moved = error_map(layout, 0)
    below = moved.elevations_deg < 30.0 + 4.9
    assert np.isnan(moved.sigmas_arcsec[below][:, moved.azimuths_deg == 90.0]).all()
    assert np.isfinite(moved.sigmas_arcsec[:, moved.azimuths_deg == 270.0]).all()


CURVES = all_curves(OperatingPoint())


def curves_of(number: int, reading: InstallationConvention) -> list[Curve]:
    return [curve for curve in CURVES if curve.sweep.number == number and curve.convention is reading]


def errors_of(number: int, reading: InstallationConvention) -> FloatArray:
    return np.array([curve.errors_arcsec for curve in curves_of(number, reading)])


@pytest.mark.parametrize("reading", list(InstallationConvention))
def test_each_figure_has_its_curves(reading: InstallationConvention) -> None:
    for sweep in SWEEPS:
        azimuths = [curve.azimuth_deg for curve in curves_of(sweep.number, reading)]
        assert azimuths == ([None] if sweep.symbol == "A0" else [0.0, 90.0, 180.0, 270.0])
        swept = curves_of(sweep.number, reading)[0].swept_deg
        assert (swept[0], swept[-1]) == sweep.range_deg


@pytest.mark.parametrize("reading", list(InstallationConvention))
def test_figure_1_is_flat(reading: InstallationConvention) -> None:
    assert np.ptp(errors_of(1, reading), axis=1).max() < 1e-9


def test_figure_5_is_flat_only_in_the_papers_convention() -> None:
    assert np.ptp(errors_of(5, InstallationConvention.PAPER), axis=1).max() < 1e-9
    assert np.nanmax(np.ptp(errors_of(5, InstallationConvention.PHYSICAL), axis=1)) > 50.0


def test_figure_3_starts_and_ends_at_the_formulas() -> None:
    """models.md §3 at Es 45°: sqrt 2 in heading for E0 = 0 abeam, none ahead; both 1/sqrt 2 at E0 = 90°."""
    heading = np.abs(errors_of(3, InstallationConvention.PAPER)[:2, :, 0])
    np.testing.assert_allclose(heading[:, 0], [0.0, 141.42], atol=0.01)
    np.testing.assert_allclose(heading[:, -1], [70.71, 70.71], atol=0.01)


def test_figure_4_adds_all_errors() -> None:
    """The curve is compared with the change of the ship's angles by all six errors at once."""
    curve = curves_of(4, InstallationConvention.PHYSICAL)[0]
    for index in (0, 100, 250):
        star, installation = np.deg2rad([235.0, 45.0, 90.0]), np.deg2rad([curve.swept_deg[index], 35.0, 0.0])
        model = linearise(star, installation)
        moved = linearise(
            star + ARCSEC * np.array([3.0, 3.0, 100.0]), installation + ARCSEC * np.array([1.0, 1.0, 20.0])
        )
        errors = (moved.ship_angles - model.ship_angles) / ARCSEC
        # The second-order term of two errors of 100″ is 0.05″.
        np.testing.assert_allclose(curve.errors_arcsec[index], errors, atol=0.15)


def test_numbers_of_boresights_do_not_overlap() -> None:
    """Sensors with equal boresights, and names longer than the plan has room for."""
    angles = {"fore": (0.0, 45.0), "mast": (0.0, 45.0), "bridge_wing_starboard": (95.0, 45.0), "wing_two": (90.0, 50.0)}
    sensors = {name: {"azimuth_deg": a, "elevation_deg": e} for name, (a, e) in angles.items()}
    computed = compute_study(study_config({"sensors": sensors}))
    figure = plan_figure(computed.layout, computed.best)
    figure.canvas.draw()
    (axes,) = figure.axes
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text()]
    boxes.append(figure.legends[0].get_window_extent())
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    legend = "\n".join(text.get_text() for text in figure.legends[0].get_texts())
    assert all(name in legend for name in angles)
    plt.close(figure)
