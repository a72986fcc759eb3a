"""Axis geometry of the theodolite: definition, first order, Jacobians, inverse, zenith, quadrants."""

from itertools import product

import numpy as np
import pytest

from ship_geometry.mount.axes import (
    NAMES,
    AxisErrors,
    AxisGeometry,
    axis_geometry,
    direction_change,
    encoder_angles,
    main_axis,
    main_axis_rotation,
)
from ship_geometry.rotations import (
    ARCSEC,
    FloatArray,
    angle_between,
    exp_rotation,
    left_jacobian,
    log_rotation,
    wrap_pi,
)

SMALL = AxisErrors(*(ARCSEC * np.array([-30.0, 20.0, -35.0, 40.0, 25.0, -38.0, 12.0])).tolist())
LARGE = AxisErrors(g=2.0, h=-0.3, c=0.04, I=-0.03, beta_x=0.02, beta_y=0.05, flexure=0.08)


def all_directions() -> tuple[FloatArray, FloatArray]:
    """Return azimuths in all quadrants and on the axes, elevations of both faces."""
    azimuth_deg = np.arange(0.0, 360.0, 15.0)
    elevation_deg = np.array([-5.0, 0.0, 10.0, 30.0, 60.0, 80.0, 89.9, 100.0, 150.0, 185.0])
    azimuth, elevation = np.meshgrid(np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg))
    return azimuth, elevation


def rx(q: float) -> FloatArray:
    """Return R_x(q) of models.md §1."""
    return np.array([[1.0, 0.0, 0.0], [0.0, np.cos(q), np.sin(q)], [0.0, -np.sin(q), np.cos(q)]])


def ry(q: float) -> FloatArray:
    """Return R_y(q) of models.md §1."""
    return np.array([[np.cos(q), 0.0, -np.sin(q)], [0.0, 1.0, 0.0], [np.sin(q), 0.0, np.cos(q)]])


def rz(q: float) -> FloatArray:
    """Return R_z(q) of models.md §1."""
    return np.array([[np.cos(q), np.sin(q), 0.0], [-np.sin(q), np.cos(q), 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("errors", [SMALL, LARGE])
def test_the_chain_of_models_5(errors: AxisErrors) -> None:
    beta_m, azimuth_m = np.hypot(errors.beta_x, errors.beta_y), np.arctan2(errors.beta_y, errors.beta_x)
    tilt = ry(azimuth_m) @ rz(beta_m) @ ry(-azimuth_m)
    azimuths, elevations = all_directions()
    found = main_axis_rotation(errors, azimuths, elevations)
    for index in np.ndindex(azimuths.shape):
        azimuth, elevation = float(azimuths[index]), float(elevations[index])
        raised = elevation - errors.h + errors.flexure * np.cos(elevation)
        expected = tilt @ ry(azimuth - errors.g) @ rx(errors.I) @ rz(-raised) @ ry(-errors.c)
        np.testing.assert_allclose(found[index], expected, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(main_axis_rotation(errors, azimuth, elevation), expected, rtol=0.0, atol=1e-14)


def test_axis_without_errors_follows_the_encoder_angles() -> None:
    azimuth, elevation = all_directions()
    expected = np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(elevation), np.sin(azimuth) * np.cos(elevation)], axis=-1
    )
    found = main_axis_rotation(AxisErrors(), azimuth, elevation)[..., 0]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-15)


def first_order(errors: FloatArray, azimuth: FloatArray, elevation: FloatArray) -> FloatArray:
    """Return the direction by [W18] (2), with E where the paper prints A; errors as (g, h, c, I, βm, Am), shape (n,
    6)."""
    g, h, c, i, beta_m, azimuth_m = errors.T
    tangent = np.tan(elevation)
    azimuth_z = azimuth - g - beta_m * np.sin(azimuth - azimuth_m) * tangent - c / np.cos(elevation) - i * tangent
    elevation_z = elevation - h - beta_m * np.cos(azimuth - azimuth_m)
    return main_axis_rotation(AxisErrors(), azimuth_z, elevation_z)[..., 0]


@pytest.mark.parametrize(("elevation_deg", "bound_arcsec"), [(-5.0, 0.1), (30.0, 0.1), (60.0, 0.1), (75.0, 0.2)])
def test_first_order_is_that_of_the_paper(elevation_deg: float, bound_arcsec: float) -> None:
    """The first order is within 0.1″ on the sky at 60° and 0.2″ at 75° for errors of 40″ each (models.md §5)."""
    signs = np.array(list(product([-40.0, 40.0], repeat=4))) * ARCSEC
    azimuths_m = np.deg2rad(np.arange(0.0, 360.0, 10.0))
    errors = np.array([[*sign, 40.0 * ARCSEC, azimuth_m] for sign, azimuth_m in product(signs, azimuths_m)])
    azimuth, elevation = np.full(len(errors), 1.0), np.full(len(errors), np.deg2rad(elevation_deg))
    exact = AxisErrors(
        *errors[:, :4].T, beta_x=errors[:, 4] * np.cos(errors[:, 5]), beta_y=errors[:, 4] * np.sin(errors[:, 5])
    )
    direction = main_axis_rotation(exact, azimuth, elevation)[..., 0]
    difference = angle_between(direction, first_order(errors, azimuth, elevation))
    assert np.max(difference) <= bound_arcsec * ARCSEC
    assert np.max(angle_between(direction, first_order(0.0 * errors, azimuth, elevation))) > 40.0 * ARCSEC


def test_flexure_raises_the_axis_by_its_cosine() -> None:
    for elevation in np.deg2rad([0.0, 60.0, 90.0]).tolist():
        raised = main_axis_rotation(
            AxisErrors(flexure=10.0 * ARCSEC), 0.3, elevation - 10.0 * ARCSEC * np.cos(elevation)
        )
        straight = main_axis_rotation(AxisErrors(), 0.3, elevation)
        assert angle_between(raised[:, 0], straight[:, 0]) <= 1e-3 * ARCSEC


@pytest.mark.parametrize("errors", [AxisErrors(), SMALL, LARGE])
def test_jacobians_are_finite_differences(errors: AxisErrors) -> None:
    """The Jacobians equal central differences of the rotation vector in the deck frame, also at the zenith."""
    azimuth, elevation = all_directions()
    elevation[3] = 0.5 * np.pi
    axis = main_axis(errors, azimuth, elevation)
    np.testing.assert_array_equal(axis.rotation_dm, main_axis_rotation(errors, azimuth, elevation))
    step = 1e-6

    def turn(after: FloatArray, before: FloatArray) -> FloatArray:
        return log_rotation(after @ np.swapaxes(before, -1, -2)) / (2.0 * step)

    for column, name in enumerate(NAMES):
        change = step * (np.arange(len(NAMES)) == column)
        after, before = (AxisErrors.from_vector(errors.vector() + sign * change) for sign in (1.0, -1.0))
        expected = turn(main_axis_rotation(after, azimuth, elevation), main_axis_rotation(before, azimuth, elevation))
        np.testing.assert_allclose(axis.by_error[..., column], expected, rtol=0.0, atol=1e-9, err_msg=name)
    for column, (da, de) in enumerate([(step, 0.0), (0.0, step)]):
        expected = turn(
            main_axis_rotation(errors, azimuth + da, elevation + de),
            main_axis_rotation(errors, azimuth - da, elevation - de),
        )
        np.testing.assert_allclose(axis.by_encoder[..., column], expected, rtol=0.0, atol=1e-9)


def test_change_of_the_direction() -> None:
    direction = np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
    by_rotation = np.random.default_rng(5).normal(size=(2, 3, 4))
    step = 1e-6
    turned = np.stack([exp_rotation(step * by_rotation[:, :, k]) @ direction[..., None] for k in range(4)], axis=-1)
    expected = (turned[:, :, 0] - direction[..., None]) / step
    np.testing.assert_allclose(direction_change(direction, by_rotation), expected, atol=1e-5)


@pytest.mark.parametrize("errors", [AxisErrors(), SMALL, LARGE])
def test_inverse_gives_the_encoder_angles_back(errors: AxisErrors) -> None:
    """The error is at most 1e-12 rad on the sky, in all quadrants, on the same face."""
    azimuth, elevation = all_directions()
    direction = main_axis_rotation(errors, azimuth, elevation)[..., 0]
    raised = elevation - errors.h + errors.flexure * np.cos(elevation)
    assert np.any(raised < 0.5 * np.pi)
    assert np.any(raised > 0.5 * np.pi)
    for plunged in (False, True):
        here = (raised > 0.5 * np.pi) == plunged
        found_azimuth, found_elevation = encoder_angles(errors, direction[here], plunged=plunged)
        assert np.all((found_azimuth >= 0.0) & (found_azimuth < 2.0 * np.pi))
        # An angle about the vertical axis counts by the cosine of the elevation.
        off = wrap_pi(found_azimuth - azimuth[here]) * np.cos(raised[here])
        np.testing.assert_allclose(off, 0.0, atol=1e-12)
        np.testing.assert_allclose(found_elevation, elevation[here], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("errors", [AxisErrors(), SMALL, LARGE])
def test_both_solutions_look_in_the_wanted_direction(errors: AxisErrors) -> None:
    wanted = np.random.default_rng(6).normal(size=(2000, 3))
    azimuths = []
    for plunged in (False, True):
        azimuth, elevation = encoder_angles(errors, wanted, plunged=plunged)
        reached = np.isfinite(azimuth)
        assert np.mean(reached) > 0.99
        found = main_axis_rotation(errors, azimuth, elevation)[reached, :, 0]
        assert np.max(angle_between(found, wanted[reached])) <= 1e-12
        azimuths.append(azimuth)
    # Near the edge of the reachable directions the two azimuths come together. 25° from the vertical axis they differ
    # by half a turn to within 2 asin(4° / 25°).
    low = np.abs(wanted[:, 1]) < 0.9 * np.linalg.norm(wanted, axis=1)
    assert np.min(np.abs(wrap_pi(azimuths[0] - azimuths[1]))[low]) > 0.85 * np.pi


def test_one_direction_is_as_many() -> None:
    wanted = np.array([[0.3, 0.4, -0.2], [-0.3, 0.1, -0.2]])
    azimuth, elevation = encoder_angles(SMALL, wanted)
    for number in range(2):
        one = encoder_angles(SMALL, wanted[number])
        np.testing.assert_allclose(one, (azimuth[number], elevation[number]), rtol=0.0, atol=1e-15)
    many = main_axis(AxisErrors.from_vector(np.tile(SMALL.vector(), (2, 1))), azimuth, elevation)
    for number in range(2):
        one_axis = main_axis(SMALL, float(azimuth[number]), float(elevation[number]))
        np.testing.assert_allclose(one_axis.rotation_dm, many.rotation_dm[number], rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(one_axis.by_error, many.by_error[number], rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(one_axis.by_encoder, many.by_encoder[number], rtol=0.0, atol=1e-15)


def test_zenith_is_reached_only_if_the_errors_allow() -> None:
    up = np.array([0.0, 1.0, 0.0])
    azimuth, elevation = encoder_angles(AxisErrors(g=0.1), up)
    assert azimuth == pytest.approx(0.1)
    assert elevation == pytest.approx(0.5 * np.pi, abs=1e-15)
    # If c and I cancel, the optical axis reaches the vertical axis; with c + I = 60″ it stays 60″ away.
    through = main_axis_rotation(AxisErrors(c=30.0 * ARCSEC, I=-30.0 * ARCSEC), 0.7, 0.5 * np.pi)[:, 0]
    assert angle_between(through, up) <= 1e-15
    axes = AxisErrors(c=20.0 * ARCSEC, I=40.0 * ARCSEC)
    off = angle_between(main_axis_rotation(axes, np.arange(6.0), np.full(6, 0.5 * np.pi))[..., 0], up)
    np.testing.assert_allclose(off, 60.0 * ARCSEC, atol=1e-12)


@pytest.mark.parametrize(("off_arcsec", "reached"), [(0.0, False), (59.99, False), (60.01, True), (80.0, True)])
def test_unreachable_directions_have_no_encoder_angles(off_arcsec: float, reached: bool) -> None:
    axes = AxisErrors(c=20.0 * ARCSEC, I=40.0 * ARCSEC)
    wanted = main_axis_rotation(AxisErrors(), 2.0, 0.5 * np.pi - off_arcsec * ARCSEC)[:, 0]
    for plunged in (False, True):
        azimuth, elevation = encoder_angles(axes, wanted, plunged=plunged)
        assert np.isfinite(azimuth) == np.isfinite(elevation) == reached


def test_vector_form() -> None:
    assert NAMES == ("g", "h", "c", "I", "beta_x", "beta_y", "flexure")
    assert AxisErrors.from_vector(LARGE.vector()) == LARGE
    assert LARGE.vector().tolist() == [2.0, -0.3, 0.04, -0.03, 0.02, 0.05, 0.08]
    many = AxisErrors(g=np.arange(3.0), c=0.5).vector()
    np.testing.assert_array_equal(many, [[0, 0, 0.5, 0, 0, 0, 0], [1, 0, 0.5, 0, 0, 0, 0], [2, 0, 0.5, 0, 0, 0, 0]])
    np.testing.assert_array_equal(AxisErrors.from_vector(many).vector(), many)


def test_the_compiled_chain_is_that_of_arrays() -> None:
    """The expected values use rotations for ship and deformation, and :func:`main_axis` for the axes."""
    rng = np.random.default_rng(2)
    azimuths, elevations = all_directions()
    for errors, azimuth, elevation in product((SMALL, LARGE), azimuths[0, ::5].tolist(), elevations[:, 0].tolist()):
        ship_n, deformation_d, rotation_v, rate_d = 1e-3 * rng.standard_normal((4, 3))
        ship_time_s, measured_nd = 0.01, exp_rotation(1e3 * rotation_v)
        geometry = axis_geometry(
            np.concatenate([ship_n, deformation_d, errors.vector(), [ship_time_s]]),
            measured_nd,
            rate_d,
            azimuth,
            elevation,
        )
        main, bent_df = main_axis(errors, azimuth, elevation), exp_rotation(deformation_d)
        rotation_nd = exp_rotation(ship_n) @ measured_nd @ exp_rotation(-ship_time_s * rate_d)
        expected = AxisGeometry(
            rotation_nd,
            bent_df @ main.rotation_dm,
            rotation_nd @ bent_df @ main.rotation_dm,
            np.hstack(
                [
                    left_jacobian(ship_n),
                    rotation_nd @ left_jacobian(deformation_d),
                    rotation_nd @ bent_df @ main.by_error,
                    -(rotation_nd @ rate_d)[:, None],
                ]
            ),
            rotation_nd @ bent_df @ main.by_encoder,
        )
        for name, found in vars(geometry).items():
            np.testing.assert_allclose(found, getattr(expected, name), rtol=0.0, atol=1e-13, err_msg=name)
