"""Robust fit of axis errors: estimates, covariance, and reported names."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_geometry.mount.axes import NAMES, AxisErrors, direction_change
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_studies.axis_fit.diagnostics import condition_number, correlated_pairs, near_dependencies, unobservable
from ship_studies.axis_fit.robust_fit import PRIOR_SIGMAS, _root_of_inverse, fit, rms, sizes
from ship_studies.axis_fit.sightings import SharedError, Sightings, coverage, directions, right_and_up
from ship_testing.axis_sightings import ERRORS, STRAIGHT, random_angles, simulate_sightings
from ship_testing.consistency import sigma_ratio_band

SEEDS = 200


@pytest.mark.parametrize("g", [0.0, 1.5, 3.1, -2.5])
def test_exact_sightings_give_the_errors_back(g: float) -> None:
    """The geometry is exact for any zero points, other errors of degrees, and both faces."""
    rng = np.random.default_rng(1)
    errors = AxisErrors(g=g, h=-0.3, c=0.01, I=-0.012, beta_x=0.02, beta_y=-0.015, flexure=0.005)
    azimuth, elevation = random_angles(rng, 80, (-5.0, 85.0))
    elevation[::2] = np.pi - elevation[::2]
    result = fit(simulate_sightings(rng, errors, (azimuth, elevation), 0.0), {})
    assert result.fitted == NAMES
    np.testing.assert_allclose(result.errors.vector(), errors.vector(), rtol=0.0, atol=1e-9)
    assert rms(result.residuals) < 1e-9
    assert not np.any(result.outliers)


@pytest.mark.statistics
@pytest.mark.parametrize("outlier_share", [0.0, 0.05])
def test_covariance_is_consistent(outlier_share: float) -> None:
    """Errors over 200 seeds are in the 99.9 % bands, with and without outliers of seven times the noise."""
    rng = np.random.default_rng(2)
    angles = random_angles(rng, 60, (10.0, 85.0))
    ratios, nees = [], []
    for _ in range(SEEDS):
        sigma = np.where(rng.random(60) < outlier_share, 40.0, 6.0)
        result = fit(simulate_sightings(rng, ERRORS, angles, sigma), STRAIGHT)
        error = (result.errors.vector() - ERRORS.vector())[:6]
        ratios.append(error / result.sigmas)
        nees.append(normalized_error_squared(error, result.covariance))
    low, high = sigma_ratio_band(SEEDS)
    ratio = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all((low <= ratio) & (ratio <= high)), ratio
    low, high = mean_nees_band(SEEDS, degrees=6)
    assert low <= np.mean(nees) <= high


@pytest.mark.slow
@pytest.mark.parametrize("stated", [True, False])
def test_shared_errors_are_in_the_covariance(stated: bool) -> None:
    """The hull rotates by 20″ with a correlation time of ten minutes, and the lever error is constant."""
    rng = np.random.default_rng(10)
    seeds, count = 40, 50
    time_s = 2.0 * np.arange(count)
    angles = 0.03 * time_s, np.deg2rad(40.0 + 30.0 * np.sin(0.06 * time_s))
    direction_d = directions(*angles)
    turned = 20.0 * ARCSEC * right_and_up(direction_d) @ direction_change(direction_d, np.eye(3))
    slow = (
        *(SharedError(f"hull.{axis}", 600.0, turned[..., axis]) for axis in range(3)),
        SharedError("lever", np.inf, 8.0 * ARCSEC * np.array([[1.0, 0.3]] * count)),
    )
    labels = ("",) * count
    moves = np.concatenate(
        [Sightings(labels, *angles, direction_d, time_s, (error,)).correlated_map() for error in slow], axis=-1
    )
    ratios, nees, known = [], [], []
    for _ in range(seeds):
        clean = simulate_sightings(rng, ERRORS, angles, 2.0)
        right_up = moves @ rng.normal(size=moves.shape[-1])
        moved = clean.direction_d + (np.swapaxes(right_and_up(clean.direction_d), 1, 2) @ right_up[..., None])[..., 0]
        moved /= np.linalg.norm(moved, axis=-1, keepdims=True)
        result = fit(
            replace(clean, direction_d=moved, time_s=time_s, correlated_errors=slow if stated else ()), STRAIGHT
        )
        error = (result.errors.vector() - ERRORS.vector())[:6]
        ratios.append(error / result.sigmas)
        nees.append(normalized_error_squared(error, result.covariance))
        known.append(result.sigmas_known)
    low, high = mean_nees_band(seeds, degrees=6)
    if not stated:
        # The sigmas would be far too small, so nearly all fits report that no sigma is known.
        assert np.mean(nees) > 10.0 * high
        assert np.mean(known) < 0.2
        return
    assert all(known)
    assert low <= np.mean(nees) <= high, np.mean(nees)
    low, high = sigma_ratio_band(seeds)
    ratio = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all((low <= ratio) & (ratio <= high)), ratio


def test_covariance_has_all_digits_despite_the_wide_prior() -> None:
    """The expected inverse is computed with exact fractions, by cofactors.

    The fit can hardly separate the first two unknowns: the data determine their sum a million times better than the
    prior does, and their difference only a few times better.
    """
    design = np.array([[[1e6, 1e6, 3.0], [0.5e6, 0.5e6 + 2.0, -1.0]], [[-2e6, -2e6, 0.25], [7.0, -1.0, 0.125]]])
    information = np.diag([1.0, 0.25, 1.0])
    rows = [[Fraction(value) for value in row] for row in design.reshape(-1, 3).tolist()]
    (a, b, c), (_, d, e), (_, _, f) = (
        [sum(row[i] * row[j] for row in rows) + Fraction(information[i, j]) for j in range(3)] for i in range(3)
    )
    cofactors = [[d * f - e * e, c * e - b * f, b * e - c * d], [c * e - b * f, a * f - c * c, b * c - a * e]]
    cofactors.append([b * e - c * d, b * c - a * e, a * d - b * b])
    determinant = a * cofactors[0][0] + b * cofactors[0][1] + c * cofactors[0][2]
    expected = np.array([[float(value / determinant) for value in row] for row in cofactors])
    root = _root_of_inverse(design, information)
    np.testing.assert_allclose(root @ root.T, expected, rtol=1e-9)


def test_outliers_are_named_and_have_little_weight() -> None:
    rng = np.random.default_rng(3)
    angles = random_angles(rng, 100, (10.0, 85.0))
    clean = simulate_sightings(rng, ERRORS, angles, 6.0)
    moved = clean.direction_d.copy()
    planted = [5, 17, 60]
    # A wrong star, a wrong row, a shift: all to one side, so that plain least squares would follow.
    moved[planted] = moved[planted] @ exp_rotation(np.array([0.0, 2.0e-3, 0.0])).T
    result = fit(Sightings(clean.labels, *angles, direction_d=moved), STRAIGHT)
    assert np.flatnonzero(result.outliers).tolist() == planted
    assert np.all(result.weights[planted] < 0.1)
    undisturbed = fit(clean, STRAIGHT)
    assert np.all(np.abs(result.errors.vector() - undisturbed.errors.vector())[:6] < 0.5 * undisturbed.sigmas)


def test_left_out_residuals_are_those_of_fits_without_the_sighting() -> None:
    rng = np.random.default_rng(4)
    sightings = simulate_sightings(
        rng, ERRORS, random_angles(rng, 40, (15.0, 80.0)), np.where(np.arange(40) < 2, 60.0, 6.0)
    )
    result = fit(sightings, STRAIGHT)
    refitted = []
    for left_out in range(40):
        kept = np.arange(40) != left_out
        labels = tuple(np.array(sightings.labels)[kept])
        others = Sightings(labels, sightings.azimuth[kept], sightings.elevation[kept], sightings.direction_d[kept])
        refitted.append(sightings.residuals(fit(others, STRAIGHT).errors)[left_out])
    # With fixed weights instead of the loss, the leave-one-out residuals would be wrong by 0.19″.
    assert np.max(sizes(np.array(refitted) - result.leave_one_out)) < 0.12 * ARCSEC
    assert rms(np.array(refitted)) == pytest.approx(rms(result.leave_one_out), rel=0.002)
    # The factor from residuals to leave-one-out residuals of ordinary sightings is 1 / (1 - 6 terms / 80 components).
    assert rms(result.leave_one_out[2:]) == pytest.approx(rms(result.residuals[2:]) / (1.0 - 6.0 / 80.0), rel=0.03)


def test_fixed_terms_stay() -> None:
    rng = np.random.default_rng(5)
    sightings = simulate_sightings(rng, ERRORS, random_angles(rng, 60, (10.0, 85.0)), 1.0)
    result = fit(sightings, {"flexure": 0.0, "c": ERRORS.c})
    assert result.fitted == ("g", "h", "I", "beta_x", "beta_y")
    assert result.errors.c == ERRORS.c
    assert result.covariance.shape == (5, 5)
    assert abs(result.errors.I - ERRORS.I) < 3.0 * result.sigmas[2]
    assert result.sigmas[2] < 0.5 * fit(sightings, STRAIGHT).sigmas[3]


def test_valley_of_a_narrow_range_of_elevation() -> None:
    """models.md §5: with E of 20-30° only, c, I and g form a valley, hundreds of times longer than wide."""
    rng = np.random.default_rng(6)
    azimuth, elevation = random_angles(rng, 300, (20.0, 30.0))
    narrow = fit(simulate_sightings(rng, ERRORS, (azimuth, elevation), 2.5), STRAIGHT)
    (valley,) = near_dependencies(narrow)
    assert valley.names == ("g", "c", "I")
    across, along = np.sqrt(np.linalg.eigvalsh(narrow.covariance)[[0, -1]])
    assert along > 500.0 * across
    assert np.linalg.norm(valley.changes) == pytest.approx(along, rel=0.1)
    assert valley.effect == pytest.approx(2.5 * ARCSEC / np.sqrt(300), rel=0.2)
    # Along the valley the pointing hardly changes, as stated.
    run = AxisErrors(**dict(zip(valley.names, valley.changes, strict=True)))
    sightings = simulate_sightings(rng, AxisErrors(), (azimuth, elevation), 0.0)
    assert rms(sightings.residuals(run)) == pytest.approx(valley.effect, rel=0.1)
    pairs = correlated_pairs(narrow)
    assert {pair[:2] for pair in pairs} == {("g", "c"), ("g", "I"), ("c", "I")}
    assert abs(pairs[0][2]) >= abs(pairs[1][2]) >= abs(pairs[2][2]) > 0.99

    # On the other face of the same targets c and I change the sign and g does not: the valley is gone.
    plunged = np.where(np.arange(300) < 150, np.pi - elevation, elevation)
    both = fit(simulate_sightings(rng, ERRORS, (azimuth, plunged), 2.5), STRAIGHT)
    assert np.max(both.sigmas) < 0.1 * np.max(narrow.sigmas)


def test_good_coverage_separates_the_errors() -> None:
    rng = np.random.default_rng(7)
    azimuth, elevation = random_angles(rng, 100, (0.0, 85.0))
    elevation[::2] = np.pi - elevation[::2]
    result = fit(simulate_sightings(rng, ERRORS, (azimuth, elevation), 5.0), STRAIGHT)
    assert near_dependencies(result) == []
    assert unobservable(result) is None
    assert condition_number(result) < 10.0


@pytest.mark.parametrize(
    ("elevations_deg", "azimuths_deg", "names", "count"),
    [
        # At one elevation g, c and I each change the azimuth by a constant; on the horizon I has no effect.
        ((30.0, 30.0), (0.0, 360.0), ("g", "c", "I"), 2),
        ((0.0, 0.0), (0.0, 360.0), ("g", "c", "I"), 2),
        # One spot: two angles for six errors.
        ((30.0, 30.0), (77.0, 77.0), ("g", "h", "c", "I", "beta_x", "beta_y"), 4),
    ],
)
def test_unobservable_errors_are_named_and_stay_at_zero(
    elevations_deg: tuple[float, float], azimuths_deg: tuple[float, float], names: tuple[str, ...], count: int
) -> None:
    rng = np.random.default_rng(8)
    angles = (np.deg2rad(rng.uniform(*azimuths_deg, 50)), np.deg2rad(rng.uniform(*elevations_deg, 50)))
    result = fit(simulate_sightings(rng, ERRORS, angles, 5.0), STRAIGHT)
    found = unobservable(result)
    assert found is not None
    assert (found.names, found.count) == (names, count)
    assert rms(result.residuals) < 10.0 * ARCSEC
    sigmas = dict(zip(result.fitted, result.sigmas, strict=True))
    assert sigmas["I"] == pytest.approx(PRIOR_SIGMAS[3], rel=0.6)
    assert abs(result.errors.I) < 10.0 * ARCSEC


def test_as_many_sightings_as_terms() -> None:
    rng = np.random.default_rng(9)
    result = fit(simulate_sightings(rng, ERRORS, random_angles(rng, 6, (10.0, 80.0)), 5.0), STRAIGHT)
    assert np.all(np.isfinite(result.covariance))
    assert np.all(np.isfinite(result.leave_one_out))


def test_residuals_are_angles_to_the_right_and_up() -> None:
    azimuth, elevation = np.array([0.3, 2.0]), np.array([0.2, 1.2])
    right, up = np.array([0.0, 30.0]) * ARCSEC, np.array([20.0, 0.0]) * ARCSEC
    sightings = Sightings(
        ("a", "b"), azimuth, elevation, directions(azimuth + right / np.cos(elevation), elevation + up)
    )
    np.testing.assert_allclose(
        sightings.residuals(AxisErrors()), np.stack([right, up], axis=-1), rtol=0.0, atol=0.01 * ARCSEC
    )
    # A residual of a quarter of a turn is the angle, not its sine.
    far = Sightings(("a",), np.array([0.0]), np.array([0.0]), directions(np.array([0.0]), np.array([0.5 * np.pi])))
    np.testing.assert_allclose(sizes(far.residuals(AxisErrors())), 0.5 * np.pi)


def test_coverage() -> None:
    azimuth, elevation = np.deg2rad([350.0, 10.0, 100.0, 280.0]), np.deg2rad([20.0, 40.0, 60.0, 30.0])
    plunged = np.array([False, True, False, False])
    encoder = np.where(plunged, azimuth + np.pi, azimuth), np.where(plunged, np.pi - elevation, elevation)
    found = coverage(Sightings(("a", "b", "c", "d"), *encoder, direction_d=directions(azimuth, elevation)))
    assert (found.count, found.plunged) == (4, 1)
    assert np.rad2deg(found.elevations) == pytest.approx([20.0, 60.0])
    assert np.rad2deg(found.azimuth_gap) == pytest.approx([100.0, 280.0])
    assert found.azimuth_gap_width == pytest.approx(np.pi)
    one = coverage(Sightings(("a",), azimuth[:1], elevation[:1], directions(azimuth[:1], elevation[:1])))
    assert one.azimuth_gap_width == pytest.approx(2.0 * np.pi)
