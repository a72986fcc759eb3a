import math
from types import SimpleNamespace

import numpy as np
import pytest

from ship_estimation.rejection_rules import LONGEST_TEXT, Reason, Rejection, shorten
from ship_msgs.msg import Innovation
from ship_node.messages.field_checks import (
    MessageRejected,
    angular_covariance,
    check_device_id,
    check_finite,
    check_frame,
    covariance_3x3,
    finite_vector,
    stamp_ns,
    unit_quaternion,
)


def quaternion(x: float, y: float, z: float, w: float) -> SimpleNamespace:
    return SimpleNamespace(x=x, y=y, z=z, w=w)


def header(sec: int, nanosec: int) -> SimpleNamespace:
    return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec))


def rejection(check, *arguments: object) -> Rejection:
    with pytest.raises(MessageRejected) as caught:
        check(*arguments)
    return caught.value.rejection


@pytest.mark.parametrize("norm", [0.9901, 1.0, 1.0099])
def test_quaternion_a_little_off_is_renormalised(norm):
    np.testing.assert_allclose(unit_quaternion(quaternion(0.6 * norm, 0.0, 0.0, -0.8 * norm)), [0.6, 0, 0, -0.8])


@pytest.mark.parametrize("norm", [0.0, 9e-7, 0.9899, 1.0101, 57.3])
def test_quaternion_far_from_norm_1_is_rejected(norm):
    assert rejection(unit_quaternion, quaternion(0.0, 0.6 * norm, 0.8 * norm, 0.0)).reason is Reason.BAD_QUATERNION


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(4))
def test_quaternion_that_is_not_finite_is_rejected(place, bad):
    numbers = [0.0, 0.0, 0.0, 1.0]
    numbers[place] = bad
    assert rejection(unit_quaternion, quaternion(*numbers)).reason is Reason.NON_FINITE


@pytest.mark.parametrize("unknown", [[0.0] * 9, [-1.0] + [0.0] * 8, [-1.0] + [math.nan] * 8])
def test_covariance_not_given_is_unknown(unknown):
    assert covariance_3x3(unknown) is None


def test_covariance_of_rounded_correlations_is_accepted_symmetric():
    # Fully correlated axes, 1 : 100 in sigma, one element off by half the tolerance.
    matrix = np.outer([1e-6, 1e-4, 1e-5], [1e-6, 1e-4, 1e-5])
    given = matrix.copy()
    given[0, 1] *= 1.0 + 0.5e-6
    checked = covariance_3x3(given.ravel())
    np.testing.assert_array_equal(checked, checked.T)
    np.testing.assert_allclose(checked, matrix, rtol=1e-6)


def test_covariance_that_rounding_made_indefinite_has_no_negative_variance():
    # Two axes have a correlation of 1 + 5e-7: the eigenvalue -5e-7 times 39 rad² would be a negative variance.
    given = 39.0 * np.array([[1.0, 1.0 + 5e-7, 0.0], [1.0 + 5e-7, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.linalg.eigvalsh(given)[0] < -1e-6
    checked = covariance_3x3(given.ravel())
    assert np.linalg.eigvalsh(checked)[0] > -1e-13
    np.testing.assert_allclose(checked, given, rtol=1e-6)


def test_covariance_with_a_perfectly_known_axis_is_a_covariance():
    np.testing.assert_array_equal(covariance_3x3(np.diag([1.0, 0.0, 2.0]).ravel()), np.diag([1.0, 0.0, 2.0]))


@pytest.mark.parametrize(
    ("matrix", "text"),
    [
        ([[1, 0, 0], [0, -1e-12, 0], [0, 0, 1]], "negative variance"),
        ([[1, 0.1, 0], [0.2, 1, 0], [0, 0, 1]], "not symmetric"),
        # The asymmetry is small against the largest variance, but large against the sigmas of its two axes.
        ([[1, 0, 0], [0, 1e-10, 1e-12], [0, -1e-12, 1e-10]], "not symmetric"),
        ([[1, 2, 0], [2, 1, 0], [0, 0, 1]], "correlation exceeds 1"),
        ([[0, 1e-9, 0], [1e-9, 1, 0], [0, 0, 1]], "correlation exceeds 1"),
        # Each pair is possible, all three together are not: eigenvalue 1 - 2 * 0.9.
        ([[1, -0.9, -0.9], [-0.9, 1, -0.9], [-0.9, -0.9, 1]], "eigenvalue -0.8"),
    ],
)
def test_invalid_covariance_is_rejected(matrix, text):
    rejected = rejection(covariance_3x3, np.array(matrix, dtype=float).ravel(), "noise_covariance")
    assert rejected.reason is Reason.BAD_COVARIANCE
    assert rejected.text.startswith("noise_covariance")
    assert text in rejected.text


def test_covariance_that_is_not_finite_is_rejected():
    assert rejection(covariance_3x3, [1, 0, 0, 0, math.nan, 0, 0, 0, 1]).reason is Reason.NON_FINITE


def test_stamp_zero_is_rejected():
    assert rejection(stamp_ns, header(0, 0), 10**18).reason is Reason.BAD_STAMP
    assert rejection(stamp_ns, header(-5, 0), 10**18).reason is Reason.BAD_STAMP


def test_stamp_with_a_second_of_nanoseconds_is_rejected():
    assert rejection(stamp_ns, header(1000, 10**9), 10**18).reason is Reason.BAD_STAMP
    assert stamp_ns(header(1000, 10**9 - 1), 10**18) == 1001 * 10**9 - 1


def test_stamp_may_be_50_ms_ahead_and_no_more():
    assert stamp_ns(header(1000, 50_000_000), 1000 * 10**9) == 1000_050_000_000
    rejected = rejection(stamp_ns, header(1000, 50_000_001), 1000 * 10**9)
    assert rejected.reason is Reason.FUTURE
    assert "0.050 s ahead" in rejected.text


def test_old_stamps_are_accepted():
    assert stamp_ns(header(1, 0), 10**18) == 10**9


def test_frame_text_has_expected_and_given_frame():
    check_frame("anything", "")
    check_frame("ins", "ins")
    rejected = rejection(check_frame, "radar", "ins")
    assert (rejected.reason, rejected.text) == (Reason.FRAME, "frame_id is 'radar': expected 'ins'")


def test_numbers_and_vectors_must_be_finite():
    check_finite("azimuth", 1.0, -2.0)
    assert rejection(check_finite, "azimuth", 1.0, math.nan).text == "azimuth holds nan"
    vector = SimpleNamespace(x=1.0, y=2.0, z=3.0)
    np.testing.assert_array_equal(finite_vector(vector, "angular_velocity"), [1.0, 2.0, 3.0])
    vector.y = math.inf
    assert rejection(finite_vector, vector, "angular_velocity").reason is Reason.NON_FINITE


def test_every_reason_is_a_constant_of_the_message_and_keeps_its_number():
    constants = {name: getattr(Innovation, name) for name in dir(Innovation) if name.isupper() and name != "SLOT_TYPES"}
    assert {reason.name: reason.value for reason in Reason} == constants
    assert (Reason.OVERFLOW, Reason.UNKNOWN_SENSOR, Reason.CLOCK) == (18, 27, 28)


def test_texts_of_messages_are_cut_with_an_ellipsis():
    endless = "x" * 10**6
    rejected = rejection(check_frame, endless, "ins")
    assert len(rejected.text) < LONGEST_TEXT
    assert rejected.text.endswith("x…': expected 'ins'")
    assert len(rejection(check_device_id, "sensor_id", endless, "fore").text) < LONGEST_TEXT
    assert MessageRejected(Reason.FRAME, endless).rejection.text == "x" * (LONGEST_TEXT - 1) + "…"
    assert len(str(MessageRejected(Reason.FRAME, endless))) < LONGEST_TEXT + 10
    assert Rejection(Reason.FRAME, endless).text == shorten(endless)
    assert shorten("x" * LONGEST_TEXT) == "x" * LONGEST_TEXT


def covariance_of_numpy(matrix: np.ndarray) -> np.ndarray | None:
    """Return the covariance by the eigenvalues of its correlations; None if an eigenvalue is below -1e-6."""
    sigma = np.sqrt(np.diagonal(matrix))
    limit = np.outer(sigma, sigma)
    symmetric = 0.5 * matrix + 0.5 * matrix.T
    eigenvalues, vectors = np.linalg.eigh(symmetric / np.where(limit > 0.0, limit, 1.0))
    if eigenvalues[0] < -1e-6:
        return None
    if eigenvalues[0] < 0.0:
        correlation = (vectors * np.maximum(eigenvalues, 0.0)) @ vectors.T
        symmetric = 0.5 * limit * (correlation + correlation.T)
    return symmetric


@pytest.mark.parametrize("least", [0.3, 1e-3, 1e-8, 1e-10, 1e-15, 0.0, -1e-15, -5e-7, -2e-6, -0.1])
def test_the_fast_covariance_check_equals_that_by_eigenvalues(least):
    """Correlations with about this smallest eigenvalue, and sigmas with ratios up to a million."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        vectors = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        matrix = (vectors * [least, *rng.uniform(0.5, 2.0, 2)]) @ vectors.T
        root = 10.0 ** rng.uniform(-6.0, 0.0, 3) / np.sqrt(np.abs(np.diagonal(matrix)))
        matrix = matrix * np.outer(root, root)
        variances = np.diagonal(matrix)
        if not (variances.min() >= 0.0 and np.all(matrix**2 <= np.outer(variances, variances) * (1.0 + 1e-12))):
            continue
        expected = covariance_of_numpy(matrix)
        if expected is None:
            assert "eigenvalue" in rejection(covariance_3x3, matrix.ravel()).text
        else:
            np.testing.assert_array_equal(covariance_3x3(matrix.ravel()), expected)


def test_a_sigma_of_more_than_a_full_turn_is_rejected():
    assert angular_covariance([39.0, 0, 0, 0, 1, 0, 0, 0, 1], "covariance")[0, 0] == 39.0
    assert "full turn" in rejection(angular_covariance, [1, 0, 0, 0, 40.0, 0, 0, 0, 1], "covariance").text
