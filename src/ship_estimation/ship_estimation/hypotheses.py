"""Several estimates side by side: by all sources, and without each of them, updated in one step.

Each estimate is a row. A measurement is compared with all rows at once. A row that does without the source of a
measurement learns of it nothing but the states that belong to that source alone (its installation): the other states,
and their covariance, are to the last digit those of an estimate that never heard of the source. So the row goes on
watching the source that it leaves out, and knows, should the source be used again, how it was mounted.

The first row has an error budget: its covariance is kept by error source. For the others one matrix each is enough. All
are kept in one stack: the n_sources parts of the first row, then the covariances of the h - 1 others.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation import compiled_steps
from ship_estimation.kalman import LinearMeasurement
from ship_estimation.protection import LEAST_SHARE, LEAST_VARIANCE_RAD2
from ship_geometry.rotations import FloatArray


class RowsCompared(NamedTuple):
    """A measurement of m components beside h rows of n states.

    Attributes:
        residual: measured minus predicted by each row, shape (h, m).
        covariance: of the residual, shape (h, m, m).
        nis: normalised innovation squared, shape (h,).
        gain: of the optimal update, shape (h, n, m).
        turn: the rotation of the device that the residual shows, whitened: of unit covariance where the row is right,
            shape (h, 3).
        turn_noise: share of the measurement's own noise in that unit covariance in the first row, shape (3, 3).
        turn_root: root of the covariance of that rotation, rad, shape (h, 3, 3): ``turn_root @ turn`` is in rad.
    """

    residual: FloatArray
    covariance: FloatArray
    nis: FloatArray
    gain: FloatArray
    turn: FloatArray
    turn_noise: FloatArray
    turn_root: FloatArray


def covariances(stack: FloatArray, rows: int) -> FloatArray:
    """The covariance of each of h rows, shape (h, n, n), of a stack of them.

    Example:
        The first row has two parts, of 1 and of 2; the second one is 5:

        >>> print(covariances(np.array([[[1.0]], [[2.0]], [[5.0]]]), rows=2).ravel())
        [3. 5.]
    """
    found: FloatArray = compiled_steps.row_covariances(np.ascontiguousarray(stack), rows)
    return found


def add_error(
    stack: FloatArray, rows: int, part: int, states: slice, covariance: FloatArray, row: int | None = None
) -> None:
    """Add an error of some states, in place, to all rows or to one of those beside the first.

    Args:
        stack: shape (n_sources + h - 1, n, n).
        rows: h.
        part: of the first row, to which the error is booked.
        states: that err.
        covariance: of the error, as many rows and columns as there are of these states.
        row: which one; None for all.

    Example:
        >>> stack = np.zeros((3, 1, 1))  # two parts of the first row, and a second row
        >>> add_error(stack, 2, part=1, states=slice(0, 1), covariance=np.array([[4.0]]))
        >>> print(stack.ravel())
        [0. 4. 4.]
    """
    first = states.indices(stack.shape[-1])[0]
    compiled_steps.add_error(stack, rows, part, first, covariance, row or 0)


def separations(means: FloatArray, stack: FloatArray, states: slice) -> tuple[FloatArray, FloatArray]:
    """How far each row is from the first one in k states, shape (h, k), and at most, in sigmas, shape (h,).

    Their sigmas are those of :func:`ship_estimation.protection.separation_sigma`. A row of which a distance is no
    number has no number of sigmas.

    Args:
        means: shape (h, n).
        stack: shape (n_sources + h - 1, n, n).
        states: in which the rows are compared.

    Example:
        The second row, of the variance 13, is six away from the first one, whose two parts are 1 and 3:

        >>> stack = np.array([1.0, 3.0, 13.0])[:, None, None]
        >>> apart, sigmas = separations(np.array([[0.0], [6.0]]), stack, slice(0, 1))
        >>> print(apart.ravel(), sigmas)
        [0. 6.] [0. 2.]
    """
    first, end, _ = states.indices(means.shape[1])
    found: tuple[FloatArray, FloatArray] = compiled_steps.separations(
        means, stack, first, end - first, LEAST_SHARE, LEAST_VARIANCE_RAD2
    )
    return found


def stand_together(means: FloatArray, stack: FloatArray, states: slice, most_sigmas: float) -> bool:
    """Whether no row is farther from the first one than so many sigmas, as :func:`separations` tells them.

    Example:
        >>> stack = np.array([1.0, 3.0, 13.0])[:, None, None]
        >>> stand_together(np.array([[0.0], [6.0]]), stack, slice(0, 1), most_sigmas=1.9)
        False
    """
    first, end, _ = states.indices(means.shape[1])
    apart: bool = compiled_steps.separated(
        means, stack, first, end - first, LEAST_SHARE, LEAST_VARIANCE_RAD2, most_sigmas
    )
    return not apart


def promoted(stack: FloatArray, rows: int, row: int) -> FloatArray:
    """The stack in which one of the rows has become the first, and the start of all others.

    That row had no budget of its own. The parts of the first row are carried over by the linear map that turns the
    covariance of the one into that of the other: their sum is right, and what each source has in it is about what it
    had. Later measurements change them as the filter does.

    Args:
        stack: shape (n_sources + h - 1, n, n).
        rows: h.
        row: which one.

    Example:
        >>> stack = np.array([[[1.0]], [[3.0]], [[8.0]]])  # parts of 1 and 3, and a second row of 8
        >>> print(promoted(stack, 2, row=1).ravel())
        [2. 6. 8.]
    """
    both = covariances(stack, rows)[[0, row]]
    sigma = np.sqrt(np.diagonal(both[0]))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(both / (scale[:, None] * scale))
    root = np.sqrt(np.maximum(values, 0.0))
    inverse = np.where(root[0] > 1e-7 * root[0, -1], 1.0 / np.where(root[0] > 0.0, root[0], 1.0), 0.0)
    to_row = (vectors[1] * root[1]) @ vectors[1].T @ (vectors[0] * inverse) @ vectors[0].T
    to_row = scale[:, None] * to_row / scale
    parts = to_row @ stack[: len(stack) - rows + 1] @ to_row.T
    # What is known exactly stays so, rounding aside.
    parts[:, sigma == 0.0, :] = parts[:, :, sigma == 0.0] = 0.0
    parts[np.argmax(np.trace(parts, axis1=-2, axis2=-1))] += both[1] - parts.sum(axis=0)
    return np.concatenate([parts, np.tile(both[1], (rows - 1, 1, 1))])


def compare_rows(
    means: FloatArray, stack: FloatArray, measurement: LinearMeasurement, at_mean: FloatArray, by_turn: FloatArray
) -> RowsCompared:
    """Compare a measurement with every row.

    Args:
        means: predicted states, shape (h, n).
        stack: their covariances, shape (n_sources + h - 1, n, n).
        measurement: linearised; its residual is that of the state ``at_mean``.
        at_mean: shape (n,).
        by_turn: derivative of the residual by a rotation of the device, shape (m, 3).

    Raises:
        numpy.linalg.LinAlgError: a covariance of the residual is not positive definite.

    Example:
        One state, known to 3 and to 4, is measured as 10 with the sigma 4; the rows stand at 0 and at 5, and the first
        one has two parts:

        >>> stack = np.array([[[5.0]], [[4.0]], [[16.0]]])
        >>> measured = LinearMeasurement(np.array([10.0]), np.array([[1.0]]), {0: np.array([[16.0]])})
        >>> means, by_turn = np.array([[0.0], [5.0]]), np.array([[1.0, 0.0, 0.0]])
        >>> found = compare_rows(means, stack, measured, np.array([0.0]), by_turn)
        >>> print(found.nis, found.gain.ravel())
        [4.      0.78125] [0.36 0.5 ]
    """
    found = compiled_steps.compared(
        means, stack, measurement.residual, measurement.jacobian, measurement.noise, at_mean, by_turn
    )
    return RowsCompared(*found)


def update_rows(
    stack: FloatArray, measurement: LinearMeasurement, compared: RowsCompared, learns: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Corrections, shape (h, n), and the stack of covariances after a measurement.

    The update has Joseph's form, which is right for any gain: that of a row that learns only some states too.

    Args:
        stack: before, shape (n_sources + h - 1, n, n).
        measurement: as compared.
        compared: by :func:`compare_rows`.
        learns: which states each row learns of it; none where the row refuses it, shape (h, n).

    Example:
        Of two states with a variance of 4 each, the sum is measured with the sigma 1. The second row learns only of the
        second state; what it knows of the first one stays, but it knows now how the two go together:

        >>> stack = np.tile(4.0 * np.eye(2), (2, 1, 1))
        >>> measured = LinearMeasurement(np.array([9.0]), np.array([[1.0, 1.0]]), {0: np.array([[1.0]])})
        >>> found = compare_rows(np.zeros((2, 2)), stack, measured, np.zeros(2), np.array([[1.0, 0.0, 0.0]]))
        >>> corrections, after = update_rows(stack, measured, found, np.array([[True, True], [False, True]]))
        >>> print(corrections, after[1].round(3).tolist())
        [[4. 4.]
         [0. 4.]] [[4.0, -1.778], [-1.778, 2.222]]
    """
    corrections, updated = compiled_steps.updated(
        np.ascontiguousarray(stack),
        measurement.jacobian,
        compared.residual,
        compared.gain,
        learns.view(np.uint8),
        measurement.booked,
        measurement.noise,
    )
    return corrections, updated
