"""What is read back of a saved document: a covariance is one, or is refused."""

import numpy as np
import pytest

from ship_node.saved_document import joint_covariance


@pytest.mark.parametrize(
    "rows",
    [
        [[4e-10, 1e-7], [1e-7, 2.5e-5]],  # an angle in rad beside a clock offset in s
        [[0.0, 0.0], [0.0, 2.5e-5]],  # the first is held fixed
        [[2.5e-5, 0.0], [0.0, 0.0]],
        [[0.0, 0.0], [0.0, 0.0]],
    ],
)
def test_covariances_are_read_as_they_are(rows):
    assert np.array_equal(joint_covariance(rows, 2), rows)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([[1.0, 0.5], [0.4, 1.0]], "not symmetric"),
        ([[1.0, 1.1], [1.1, 1.0]], "not positive semidefinite"),
        ([[0.0, 0.1], [0.1, 1.0]], "not positive semidefinite"),  # held fixed, and still correlated
        ([[-1.0, 0.0], [0.0, 1.0]], "not positive semidefinite"),
        ([[1.0, 0.0]], "expected 2 x 2 finite numbers"),
        ([[1.0, float("nan")], [float("nan"), 1.0]], "expected 2 x 2 finite numbers"),
    ],
)
def test_other_matrices_are_refused(rows, text):
    with pytest.raises(ValueError, match=text):
        joint_covariance(rows, 2)
