"""Direction of a target: geometry, derivatives against finite differences, errors against the covariance.

The truth is drawn here, by formulas of this file, without any of the tested code.
"""

import functools
from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import build, nest
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.mount.line_of_sight import EARTH_RADIUS_M
from ship_geometry.rotations import ARCSEC, exp_rotation
from theodolite_calib.config import MainDetectorConfig, OpticalAxisConfig
from theodolite_calib.messages.output_messages import direction_angles
from theodolite_calib.optical_axis.core import OpticalAxisCore
from theodolite_calib.optical_axis.target_direction import observed_direction, ranged_position
from theodolite_calib.samples.samples import EncoderSample, PointingOutcome, ShipSample, TargetEstimate, TargetSample

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
DETECTOR = MainDetectorConfig(focal_length_m=1.5, principal_x_m=2e-4, principal_z_m=-3e-4)
DRAWS = 1000
ZERO = np.zeros(3)

AXIS_NAMES = ("g", "h", "c", "I", "beta_x", "beta_y")
CONFIG = {
    "telescope.telescope_id": "calibration",
    "telescope.focal_length_m": 0.1,
    "lever.forward_m": 12.0,
    "lever.up_m": 3.0,
    "lever.right_m": -2.0,
    "lever.sigma_m": 0.02,
    "air.sigma": 0.06,
    "air.light_sigma": 0.02,
    "deformation.sigma_arcsec": 5.0,
    "main_detector.focal_length_m": 1.5,
    "main_detector.focal_length_sigma_m": 1e-4,
    "main_detector.principal_x_m": 2e-4,
    "main_detector.principal_z_m": -3e-4,
    "main_detector.principal_sigma_m": 5e-6,
    "main_detector.rotation_sigma_arcsec": 60.0,
    **{f"axes.{name}_sigma_arcsec": 8.0 for name in AXIS_NAMES},
}
SHIP_SIGMA_N = ARCSEC * np.array([4.0, 6.0, 4.0])
IMAGE_SIGMA_M, RANGE_SIGMA_M = 5e-6, 0.05


def image_of(vector_v: np.ndarray, focal_length_m: float, principal_m: np.ndarray) -> np.ndarray:
    """Return the inverted image of a vector (forward, up, right): right of the axis at x < 0, above it at z < 0."""
    forward, up, right = vector_v
    return principal_m - focal_length_m * np.array([right, up]) / forward


@pytest.mark.parametrize(
    ("point_m", "rotation_deg", "expected_deg"),
    [
        ((0.0, 0.0), 0.0, (30.0, 20.0)),
        ((-0.015, 0.0), 0.0, None),  # to the right
        ((0.0, -0.015), 0.0, None),  # above
    ],
)
def test_the_image_is_inverted(point_m, rotation_deg, expected_deg) -> None:
    rotation_nm = rotation_from_angles(*np.deg2rad([30.0, 20.0, 0.0]))
    point = DETECTOR.principal_point_m + point_m
    seen = observed_direction(DETECTOR, point, 1e-6, np.deg2rad(rotation_deg), rotation_nm)
    if expected_deg is not None:
        angles, _ = direction_angles(seen.direction_n, np.zeros((3, 3)))
        np.testing.assert_allclose(np.rad2deg(angles), expected_deg, atol=1e-12)
    right, up = rotation_nm[:, 2] @ seen.direction_n, rotation_nm[:, 1] @ seen.direction_n
    expected = -np.array(point_m) / np.hypot(1.5, np.abs(point_m).max())
    np.testing.assert_allclose(np.array([right, up]), expected, atol=1e-12)


def test_a_detector_that_is_rolled_right_side_down_has_its_right_below() -> None:
    # 90°, right side down: what is to the right on the detector is below the main axis.
    seen = observed_direction(
        DETECTOR, DETECTOR.principal_point_m + np.array([-0.015, 0.0]), 1e-6, 0.5 * np.pi, np.eye(3)
    )
    np.testing.assert_allclose(seen.direction_n, np.array([1.5, -0.015, 0.0]) / np.hypot(1.5, 0.015), atol=1e-12)


def central_difference(function, at: np.ndarray, step: float) -> np.ndarray:
    columns = [(function(at + e) - function(at - e)) / (2.0 * step) for e in step * np.eye(len(at))]
    return np.stack(columns, axis=-1)


def random_geometry(seed: int):
    rng = np.random.default_rng(seed)
    azimuth, elevation, roll = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(-5, 85)), rng.uniform(-np.pi, np.pi)
    point_m = DETECTOR.principal_point_m + rng.uniform(-0.02, 0.02, 2)
    return rotation_from_angles(azimuth, elevation, roll), point_m, rng.uniform(-np.pi, np.pi)


@pytest.mark.parametrize("seed", range(20))
def test_derivatives_of_the_direction(seed: int) -> None:
    rotation_nm, point_m, rho = random_geometry(seed)

    def direction_n(turn_n=ZERO, point=point_m, detector=DETECTOR, rotation=rho):
        return observed_direction(detector, point, 0.0, rotation, exp_rotation(turn_n) @ rotation_nm).direction_n

    seen = observed_direction(DETECTOR, point_m, 0.0, rho, rotation_nm)
    np.testing.assert_allclose(seen.by_turn_n, central_difference(direction_n, np.zeros(3), 1e-6), atol=1e-9)
    # For each error of the detector alone, the covariance is the variance times the square of the derivative.
    of_point = central_difference(lambda p: direction_n(point=p), point_m, 1e-6)
    sigma_m = 3e-6
    found = observed_direction(DETECTOR, point_m, sigma_m, rho, rotation_nm).image_covariance_n
    np.testing.assert_allclose(found, sigma_m**2 * of_point @ of_point.T, rtol=1e-6, atol=1e-20)
    principal_m = DETECTOR.principal_point_m
    of_focal_length = central_difference(
        lambda f: direction_n(detector=replace(DETECTOR, focal_length_m=float(f[0]))), np.array([1.5]), 1e-5
    )
    of_principal = central_difference(
        lambda p: direction_n(detector=replace(DETECTOR, principal_x_m=p[0], principal_z_m=p[1])), principal_m, 1e-6
    )
    of_rotation = central_difference(lambda r: direction_n(rotation=float(r[0])), np.array([rho]), 1e-6)
    for wrong, by, sigma in (
        (replace(DETECTOR, focal_length_sigma_m=2e-4), of_focal_length, 2e-4),
        (replace(DETECTOR, principal_sigma_m=4e-6), of_principal, 4e-6),
        (replace(DETECTOR, rotation_sigma_arcsec=1e-4 / ARCSEC), of_rotation, 1e-4),
    ):
        found = observed_direction(wrong, point_m, 0.0, rho, rotation_nm).image_covariance_n
        np.testing.assert_allclose(found, sigma**2 * by @ by.T, rtol=1e-5, atol=1e-18)


@pytest.mark.parametrize("seed", range(10))
def test_derivatives_of_angles_and_place(seed: int) -> None:
    rotation_nm, _, _ = random_geometry(seed)
    direction_n = rotation_nm[:, 0]
    across = rotation_nm[:, 1:]
    covariance_n = across @ np.diag([1e-10, 4e-10]) @ across.T

    def moved_direction(offset):
        vector = direction_n + across @ offset
        return vector / np.linalg.norm(vector)

    by_offset = central_difference(lambda o: direction_angles(moved_direction(o), covariance_n)[0], np.zeros(2), 1e-6)
    _, found = direction_angles(direction_n, covariance_n)
    np.testing.assert_allclose(found, by_offset @ np.diag([1e-10, 4e-10]) @ by_offset.T, rtol=1e-6)

    place = ranged_position(direction_n, 2000.0, 0.13)
    ranges_m = np.array([2000.0])
    by_range = central_difference(lambda r: ranged_position(direction_n, float(r[0]), 0.13).path_n, ranges_m, 0.1)
    np.testing.assert_allclose(place.by_range_n, by_range[:, 0], atol=1e-8)
    by_k = central_difference(
        lambda k: ranged_position(direction_n, 2000.0, float(k[0])).path_n, np.array([0.13]), 1e-3
    )
    np.testing.assert_allclose(place.by_coefficient_n, by_k[:, 0], atol=2e-5)  # of 0.31 m
    by_direction = central_difference(
        lambda o: ranged_position(moved_direction(o), 2000.0, 0.13).path_n, np.zeros(2), 1e-6
    )
    np.testing.assert_allclose(place.by_direction_n @ across, by_direction, atol=0.05)  # of 2000 m: refraction, 2e-5


def test_refraction_over_two_kilometres_is_four_centimetres() -> None:
    # models.md §5: k d / (2 R) = 4.2" at 2 km.
    place = ranged_position(np.array([1.0, 0.0, 0.0]), 2000.0, 0.13)
    assert np.arcsin(-place.path_n[1] / 2000.0) / ARCSEC == pytest.approx(4.21, abs=0.01)


def config(**changes) -> OpticalAxisConfig:
    return build(OpticalAxisConfig, nest({**CONFIG, **{name.replace("__", "."): v for name, v in changes.items()}}))


def run_target(seed: int, settings: OpticalAxisConfig, plunged: bool) -> tuple[TargetEstimate, np.ndarray, np.ndarray]:
    """Return the core's result for a target, its true direction, and its true position from the ship's antenna, in n.

    The ship rotates at up to 1°/s, and the mount at up to 1°/s per axis. Only encoders and ship/attitude are present:
    the errors are those of the configuration and of the messages.
    """
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal
    azimuth, elevation = rng.uniform(0.0, 2.0 * np.pi), np.deg2rad(rng.uniform(-5.0, 85.0))
    attitude_nd = rotation_from_angles(*np.deg2rad([rng.uniform(0.0, 360.0), *rng.uniform(-6.0, 6.0, 2)]))
    rate_d, angle_rates = np.deg2rad(rng.uniform(-1.0, 1.0, 3)), np.deg2rad(rng.uniform(-1.0, 1.0, 2))
    # The wanted line in the deck gives the angles of a perfect mount, plunged or not.
    line_d = attitude_nd.T @ rotation_from_angles(azimuth, elevation, 0.0)[:, 0]
    angles = np.array([np.arctan2(line_d[2], line_d[0]), np.arcsin(line_d[1])])
    if plunged:
        angles = np.array([angles[0] + np.pi, np.pi - angles[1]])
    axes = ARCSEC * np.array([*(8.0 * normal(6)), 0.0])
    deformation = 5.0 * ARCSEC * normal(3)
    ship_error_n = SHIP_SIGMA_N * normal(3)
    lever_d = np.array([12.0, 3.0, -2.0]) + 0.02 * normal(3)
    coefficient = 0.13 + 0.06 * normal() + 0.02 * normal()

    def deck_at(t_s):
        return attitude_nd @ exp_rotation(rate_d * t_s)

    def main_at(t_s):
        azimuth_e, elevation_e = (angles + angle_rates * t_s).tolist()
        mount = main_axis_rotation(AxisErrors.from_vector(axes), azimuth_e, elevation_e)
        return deck_at(t_s) @ exp_rotation(deformation) @ mount

    core = OpticalAxisCore(settings)
    white = settings.ship.white_sigma_arcsec * ARCSEC
    for step in range(5):
        t_s = 0.05 * step - 0.1
        stamp_ns = START_NS + round(t_s * SECOND_NS)
        measured_nd = exp_rotation(-white * normal(3)) @ exp_rotation(-ship_error_n) @ deck_at(t_s)
        core.pointings.add_ship(ShipSample(stamp_ns, measured_nd, rate_d, np.diag(SHIP_SIGMA_N**2)))
        reading = angles + angle_rates * t_s + ARCSEC * normal(2)
        core.pointings.add_encoder(EncoderSample(stamp_ns, reading, ARCSEC))
    t_s = rng.uniform(-0.04, 0.04)
    rho = rng.uniform(-np.pi, np.pi)
    right, up = np.tan(np.deg2rad(rng.uniform(-0.5, 0.5, 2)))
    target_m = np.array([1.0, up, right]) / np.linalg.norm([1.0, up, right])
    direction_n = main_at(t_s) @ target_m
    distance_m = rng.uniform(200.0, 4000.0)
    # Refraction raises the apparent direction: the target itself is lower by this amount.
    path_n = distance_m * direction_n - [0.0, coefficient * distance_m**2 / (2.0 * EARTH_RADIUS_M), 0.0]
    rolled = rho + 60.0 * ARCSEC * normal()
    cosine, sine = np.cos(rolled), np.sin(rolled)
    # Axes of a detector whose right side is down by the angle, in the main frame (forward, up, right).
    up_m, right_m = np.array([0.0, cosine, sine]), np.array([0.0, -sine, cosine])
    principal_m = np.array([2e-4, -3e-4]) + 5e-6 * normal(2)
    point_m = image_of(target_m @ np.array([[1.0, 0.0, 0.0], up_m, right_m]).T, 1.5 + 1e-4 * normal(), principal_m)
    sample = TargetSample(
        time_ns=START_NS + round(t_s * SECOND_NS),
        target_id="buoy",
        point_m=point_m + IMAGE_SIGMA_M * normal(2),
        sigma_m=IMAGE_SIGMA_M,
        exposure_s=0.0,
        detector_rotation=rho,
        range_m=float(np.linalg.norm(path_n)) + RANGE_SIGMA_M * normal(),
        range_sigma_m=RANGE_SIGMA_M,
    )
    (estimate,) = core.pointings.add_target(sample).targets
    return estimate, direction_n, deck_at(t_s) @ lever_d + path_n


@functools.cache
def nees_of_draws(plunged: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return NEES of the direction's two components, of azimuth and elevation, and of the position, shape (DRAWS,)
    each."""
    settings, direction, angles, place = config(), [], [], []
    for seed in range(DRAWS):
        estimate, true_n, true_place_n = run_target(seed + DRAWS * plunged, settings, plunged)
        assert estimate.status is Status.DEGRADED  # no light was ever seen
        across = np.linalg.svd(estimate.direction_n[None])[2][1:]
        error_n = true_n - estimate.direction_n
        direction.append(normalized_error_squared(across @ error_n, across @ estimate.covariance_n @ across.T))
        estimated, covariance = direction_angles(estimate.direction_n, estimate.covariance_n)
        error = direction_angles(true_n, np.zeros((3, 3)))[0] - estimated
        error[0] = (error[0] + np.pi) % (2.0 * np.pi) - np.pi
        angles.append(normalized_error_squared(error, covariance))
        place.append(normalized_error_squared(true_place_n - estimate.position_n, estimate.position_covariance_n))
    return np.array(direction), np.array(angles), np.array(place)


@pytest.mark.statistics
@pytest.mark.parametrize("plunged", [False, True])
def test_errors_match_the_covariance(plunged: bool) -> None:
    """Azimuth 0-360°, elevation -5 to 85°, detector ±180°; plunged, the image of the main axis is upside down."""
    direction, angles, place = nees_of_draws(plunged)
    for nees, degrees in ((direction, 2), (angles, 2), (place, 3)):
        low, high = mean_nees_band(DRAWS, degrees)
        assert low < nees.mean() < high


def test_an_exposure_of_known_length_is_brought_to_its_middle() -> None:
    """A mount swings by 1° in 2 s: the mean image over 0.2 s is 60" off, and below 1" if the exposure length is
    stated."""
    swing, period_s, exposure_s = np.deg2rad(1.0), 2.0, 0.2

    def elevation(t_s: float) -> float:
        return 0.5 + swing * np.cos(2.0 * np.pi * t_s / period_s)

    def point_m(t_s: float) -> np.ndarray:
        seen_m = rotation_from_angles(1.0, elevation(t_s), 0.0).T @ rotation_from_angles(1.002, 0.52, 0.0)[:, 0]
        return image_of(seen_m, 1.5, np.array([2e-4, -3e-4]))

    times_s = exposure_s * ((np.arange(1000) + 0.5) / 1000 - 0.5)
    mean_m = np.mean([point_m(t_s) for t_s in times_s], axis=0)
    off = {}
    for stated_s in (exposure_s, 0.0):
        core = OpticalAxisCore(config())
        for step in range(-50, 51):
            stamp_ns = START_NS + step * SECOND_NS // 100
            core.pointings.add_ship(ShipSample(stamp_ns, np.eye(3), np.zeros(3), np.diag(SHIP_SIGMA_N**2)))
            core.pointings.add_encoder(EncoderSample(stamp_ns, np.array([1.0, elevation(0.01 * step)]), ARCSEC))
        sample = TargetSample(START_NS, "buoy", mean_m, 1e-6, stated_s, 0.0, np.nan, np.nan)
        (estimate,) = core.pointings.add_target(sample).targets
        off[stated_s] = np.linalg.norm(estimate.direction_n - rotation_from_angles(1.002, 0.52, 0.0)[:, 0]) / ARCSEC
    # swing (2 pi / period)^2 T^2 / 24 = 59"; the rest after the reduction is from the fourth derivative.
    assert off[0.0] == pytest.approx(59.2, abs=1.5)
    assert off[exposure_s] < 1.0


def test_an_estimator_that_replaces_another_one_goes_on_with_its_pointings_and_images() -> None:
    """The second estimator answers the pending image once, and does not repeat the answered one."""

    def pointings(core: OpticalAxisCore, steps: range) -> list[PointingOutcome]:
        outcomes = []
        for step in steps:
            stamp_ns = START_NS + step * SECOND_NS // 100
            ship = ShipSample(stamp_ns, np.eye(3), np.zeros(3), np.diag(SHIP_SIGMA_N**2))
            outcomes.append(core.pointings.add_ship(ship))
            outcomes.append(core.pointings.add_encoder(EncoderSample(stamp_ns, np.array([1.0, 0.5]), ARCSEC)))
        return outcomes

    def image(since_ns: int) -> TargetSample:
        return TargetSample(START_NS + since_ns, "buoy", np.zeros(2), 1e-6, 0.0, 0.0, np.nan, np.nan)

    live = OpticalAxisCore(config())
    second = live.make_second(None)
    before, _ = pointings(live, range(-50, 1)), pointings(second, range(-50, 1))
    assert len(live.pointings.add_target(image(-100_000_000)).targets) == 1
    assert not live.pointings.add_target(image(5_000_000)).targets
    last_ns = max(estimate.time_ns for outcome in before for estimate in outcome.estimates)
    second.take_over_outputs(live)
    assert second.pointings.add_target(image(-100_000_000)).rejection is not None
    after = pointings(second, range(1, 5))
    assert [target.time_ns for outcome in after for target in outcome.targets] == [START_NS + 5_000_000]
    times_ns = [estimate.time_ns for outcome in after for estimate in outcome.estimates]
    assert times_ns == [last_ns + step * SECOND_NS // 100 for step in range(1, 5)]
