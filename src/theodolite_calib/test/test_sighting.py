"""Predicted points: Jacobians as a filter uses them."""

import numpy as np
import pytest

from ship_geometry.rotations import exp_rotation
from ship_testing.simulated_sightings import CAMERA, error_free, truth_of
from theodolite_calib.lights.light_points import predict_points

TRUTH = truth_of(np.array([10.0, 100.0, 190.0, 280.0]), np.array([-5.0, 40.0, 85.0, 90.0]), 50.0)
EPOCHS = error_free(TRUTH)
DIRECTION_N = EPOCHS.lines().direction_n
PREDICTED = predict_points(CAMERA, TRUTH.rotation_nt, DIRECTION_N)


def test_predicted_is_seen():
    # The refraction of the simulation is the same to 1e-9 rad.
    assert PREDICTED.point_m == pytest.approx(EPOCHS.image.point_m, abs=1e-10)


def test_by_attitude_equals_finite_differences():
    step = 1e-6
    for column, change in enumerate(np.eye(3) * step):
        more, less = (
            predict_points(CAMERA, exp_rotation(sign * change) @ TRUTH.rotation_nt, DIRECTION_N).point_m
            for sign in (1.0, -1.0)
        )
        assert PREDICTED.by_attitude_n[..., column] == pytest.approx((more - less) / (2.0 * step), abs=1e-10)


def test_by_direction_equals_finite_differences():
    step = 1e-6
    for column, change in enumerate(np.eye(3) * step):
        more, less = (
            predict_points(CAMERA, TRUTH.rotation_nt, DIRECTION_N + sign * change).point_m for sign in (1.0, -1.0)
        )
        assert PREDICTED.by_direction_n[..., column] == pytest.approx((more - less) / (2.0 * step), abs=1e-10)


def test_by_focal_length_is_the_distance_from_the_principal_point():
    expected = (PREDICTED.point_m - CAMERA.principal_point_m) / CAMERA.focal_length_m
    assert PREDICTED.by_focal_length == pytest.approx(expected, abs=1e-15)
