"""Camera of the calibration telescope and its predicted points: axes, derivatives, covariance."""

import numpy as np
import pytest

from ship_geometry.mount.image import Camera, predict_points, unit_vector_jacobian
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_testing.simulated_sightings import CAMERA as PAPER_CAMERA
from ship_testing.simulated_sightings import error_free_epochs, truth_of

CAMERA = Camera(0.1, 1e-4, np.array([3e-4, -5e-4]))

TRUTH = truth_of(np.array([10.0, 100.0, 190.0, 280.0]), np.array([-5.0, 40.0, 85.0, 90.0]), 50.0)
EPOCHS = error_free_epochs(TRUTH)
DIRECTION_N = EPOCHS.lines().direction_n
PREDICTED = predict_points(PAPER_CAMERA, TRUTH.rotation_nt, DIRECTION_N)


def points(count: int = 300) -> FloatArray:
    """Return points all over a detector of 40 mm, up to 11° from the axis in each coordinate."""
    return np.random.default_rng(1).uniform(-0.02, 0.02, (count, 2, 2))


def test_axes_of_the_models_page():
    # V ∝ [f, -z, -x]; numbers small enough to divide by hand.
    camera = Camera(0.1, 0.0, np.zeros(2))
    axis, right, above = camera.directions(np.array([[0.0, 0.0], [-0.01, 0.0], [0.0, -0.02]]))
    assert axis == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)
    assert right == pytest.approx(np.array([0.1, 0.0, 0.01]) / np.hypot(0.1, 0.01), abs=1e-15)
    assert above == pytest.approx(np.array([0.1, 0.02, 0.0]) / np.hypot(0.1, 0.02), abs=1e-15)


def test_principal_point_is_the_image_of_the_axis():
    assert CAMERA.directions(np.array([[3e-4, -5e-4]]))[0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)


def test_there_and_back_by_any_length():
    point_m = points()
    direction_t = CAMERA.directions(point_m)
    assert np.linalg.norm(direction_t, axis=-1) == pytest.approx(np.ones(point_m.shape[:-1]), abs=1e-14)
    assert CAMERA.points(7.0 * direction_t) == pytest.approx(point_m, abs=1e-16)


def test_each_exposure_has_its_focal_length():
    focal_length_m = np.array([0.09, 0.1, 0.11])
    many = Camera(focal_length_m, 0.0, CAMERA.principal_point_m)
    for i, focal in enumerate(focal_length_m):
        alone = Camera(float(focal), 0.0, CAMERA.principal_point_m)
        assert many.directions(points(3))[i] == pytest.approx(alone.directions(points(3)[i]), abs=1e-15)
        assert many.points(many.directions(points(3)))[i] == pytest.approx(points(3)[i], abs=1e-16)


def test_points_behind_the_telescope_are_nan():
    behind = np.array([[-1.0, 0.1, 0.1], [0.0, 1.0, 0.0], [1.0, 0.1, 0.1]])
    assert np.isnan(CAMERA.points(behind)).all(axis=-1).tolist() == [True, True, False]
    predicted = predict_points(CAMERA, np.eye(3), behind)
    for values in (predicted.point_m, predicted.by_focal_length, predicted.by_direction_n[..., 0, :]):
        assert np.isnan(values).all(axis=-1).tolist() == [True, True, False]


def test_direction_by_point_and_by_principal_point_equals_finite_differences():
    point_m, step = points(), 1e-7
    for column, change in enumerate(np.eye(2) * step):
        expected = (CAMERA.directions(point_m + change) - CAMERA.directions(point_m - change)) / (2.0 * step)
        assert CAMERA.direction_by_point(point_m)[..., column] == pytest.approx(expected, abs=1e-6)
        more, less = (Camera(0.1, 0.0, CAMERA.principal_point_m + c) for c in (change, -change))
        by_principal_point = (more.directions(point_m) - less.directions(point_m)) / (2.0 * step)
        assert -CAMERA.direction_by_point(point_m)[..., column] == pytest.approx(by_principal_point, abs=1e-6)


def test_direction_by_focal_length_equals_finite_differences():
    point_m, step = points(), 1e-6
    more, less = (Camera(0.1 + change, 0.0, CAMERA.principal_point_m) for change in (step, -step))
    expected = (more.directions(point_m) - less.directions(point_m)) / (2.0 * step)
    assert CAMERA.direction_by_focal_length(point_m) == pytest.approx(expected, abs=1e-7)


def test_points_by_direction_and_focal_length_equal_finite_differences():
    direction_t, step = 1.3 * CAMERA.directions(points()), 1e-6
    rotation_nt = exp_rotation(np.random.default_rng(6).standard_normal((len(direction_t), 3)))
    predicted = predict_points(CAMERA, rotation_nt, direction_t @ rotation_nt.swapaxes(-1, -2))
    assert predicted.point_m == pytest.approx(CAMERA.points(direction_t), abs=1e-16)
    for column in range(3):
        change = step * rotation_nt[:, None, column]
        expected = (CAMERA.points(direction_t + change) - CAMERA.points(direction_t - change)) / (2.0 * step)
        assert predicted.by_direction_n[..., column] == pytest.approx(expected, abs=1e-11)
    more, less = (Camera(0.1 + change, 0.0, CAMERA.principal_point_m) for change in (step, -step))
    expected = (more.points(direction_t) - less.points(direction_t)) / (2.0 * step)
    assert predicted.by_focal_length == pytest.approx(expected, abs=1e-10)


def test_a_tenth_of_a_pixel_of_the_paper_is_1_34_arcseconds_on_the_axis():
    covariance = CAMERA.direction_covariance(CAMERA.principal_point_m[None], 0.65e-6)[0]
    sigma = 0.65e-6 / 0.1
    assert covariance == pytest.approx(np.diag([0.0, sigma**2, sigma**2]), abs=1e-24)
    assert np.sqrt(covariance[1, 1]) / ARCSEC == pytest.approx(1.34, abs=0.005)


def test_direction_covariance_is_that_of_scattered_points():
    point_m, sigma_m = np.array([[0.015, -0.018], [-0.002, 0.004]]), np.array([2e-6, 5e-6])
    count = 40_000
    scattered = point_m + sigma_m[:, None] * np.random.default_rng(2).standard_normal((count, 2, 2))
    off = CAMERA.directions(scattered) - CAMERA.directions(point_m)
    covariance = CAMERA.direction_covariance(point_m, sigma_m)
    # Four standard deviations of a sample covariance.
    scale = np.trace(covariance, axis1=-1, axis2=-2)[:, None, None]
    sample = np.einsum("nki,nkj->kij", off, off) / count
    assert np.all(np.abs(sample - covariance) < 4.0 * np.sqrt(2.0 / count) * scale)
    along = np.einsum("ki,kij->kj", CAMERA.directions(point_m), covariance)
    assert along == pytest.approx(np.zeros((2, 3)), abs=1e-24)


def test_unit_vector_jacobian_equals_finite_differences():
    vector, step = np.array([[300.0, -20.0, 1500.0], [0.0, 2.0, 0.0]]), 1e-4
    unit = lambda v: v / np.linalg.norm(v, axis=-1, keepdims=True)  # noqa: E731
    for column, change in enumerate(np.eye(3) * step):
        expected = (unit(vector + change) - unit(vector - change)) / (2.0 * step)
        assert unit_vector_jacobian(vector)[..., column] == pytest.approx(expected, abs=1e-8)


def test_predicted_is_seen():
    # The refraction of the simulation is the same to 1e-9 rad.
    assert PREDICTED.point_m == pytest.approx(EPOCHS.image.point_m, abs=1e-10)


def test_by_attitude_equals_finite_differences():
    step = 1e-6
    for column, change in enumerate(np.eye(3) * step):
        more, less = (
            predict_points(PAPER_CAMERA, exp_rotation(sign * change) @ TRUTH.rotation_nt, DIRECTION_N).point_m
            for sign in (1.0, -1.0)
        )
        assert PREDICTED.by_attitude_n[..., column] == pytest.approx((more - less) / (2.0 * step), abs=1e-10)


def test_by_direction_equals_finite_differences():
    step = 1e-6
    for column, change in enumerate(np.eye(3) * step):
        more, less = (
            predict_points(PAPER_CAMERA, TRUTH.rotation_nt, DIRECTION_N + sign * change).point_m for sign in (1.0, -1.0)
        )
        assert PREDICTED.by_direction_n[..., column] == pytest.approx((more - less) / (2.0 * step), abs=1e-10)


def test_by_focal_length_is_the_distance_from_the_principal_point():
    expected = (PREDICTED.point_m - PAPER_CAMERA.principal_point_m) / PAPER_CAMERA.focal_length_m
    assert PREDICTED.by_focal_length == pytest.approx(expected, abs=1e-15)
