"""Several estimates side by side: by all sources, and without each of them, updated in one step.

Each estimate is a row: a mean (n,) and a covariance by error source (n_sources, n, n), on a leading axis of h rows. A
measurement is compared with all rows at once. A row that does without the source of a measurement learns of it nothing
but the states that belong to that source alone (its installation): the other states, and their covariance, are to the
last digit those of an estimate that never heard of the source. So the row goes on watching the source that it leaves
out, and knows, should the source be used again, how it was mounted.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg.lapack as lapack
from numpy.typing import NDArray

from ship_estimation.kalman import LinearMeasurement
from ship_geometry.rotations import FloatArray


@dataclass(frozen=True)
class RowsCompared:
    """A measurement of m components beside h rows of n states.

    Attributes:
        residual: measured minus predicted by each row, shape (h, m).
        covariance: of the residual, shape (h, m, m).
        nis: normalised innovation squared, shape (h,).
        gain: of the optimal update, shape (h, n, m).
        turn: the rotation of the device that the residual shows, whitened: of unit covariance where the row is right,
            shape (h, 3).
        turn_noise: share of the measurement's own noise in that unit covariance, shape (h, 3, 3).
        turn_root: root of the covariance of that rotation, rad, shape (h, 3, 3): ``turn_root @ turn`` is in rad.
    """

    residual: FloatArray
    covariance: FloatArray
    nis: FloatArray
    gain: FloatArray
    turn: FloatArray
    turn_noise: FloatArray
    turn_root: FloatArray


def compare_rows(
    means: FloatArray, parts: FloatArray, measurement: LinearMeasurement, at_mean: FloatArray, by_turn: FloatArray
) -> RowsCompared:
    """Compare a measurement with every row.

    Args:
        means: predicted states, shape (h, n).
        parts: their covariance by source, shape (h, n_sources, n, n).
        measurement: linearised; its residual is that of the state ``at_mean``.
        at_mean: shape (n,).
        by_turn: derivative of the residual by a rotation of the device, shape (m, 3).

    Raises:
        numpy.linalg.LinAlgError: a covariance of the residual is not positive definite.

    Example:
        One state, known to 3 and to 4, is measured as 10 with the sigma 4; the rows stand at 0 and at 5:

        >>> parts = np.array([[[[9.0]]], [[[16.0]]]])
        >>> measured = LinearMeasurement(np.array([10.0]), np.array([[1.0]]), {0: np.array([[16.0]])})
        >>> means, by_turn = np.array([[0.0], [5.0]]), np.array([[1.0, 0.0, 0.0]])
        >>> found = compare_rows(means, parts, measured, np.array([0.0]), by_turn)
        >>> print(found.nis, found.gain.ravel())
        [4.      0.78125] [0.36 0.5 ]
    """
    h, noise = measurement.jacobian, measurement.noise
    residual = measurement.residual - (means - at_mean) @ h.T
    cross = parts.sum(axis=1) @ h.T
    covariance = h @ cross + noise
    size, states = len(measurement.residual), means.shape[-1]
    asked = np.empty((size, states + 4))
    asked[:, states + 1 :] = by_turn
    nis, gain = np.empty(len(means)), np.empty_like(cross)
    turn, turn_noise, turn_root = np.empty((len(means), 3)), np.empty((len(means), 3, 3)), np.empty((len(means), 3, 3))
    for row in range(len(means)):
        asked[:, :states], asked[:, states] = cross[row].T, residual[row]
        _, solved, info = lapack.dposv(covariance[row], asked)
        if info != 0:
            raise np.linalg.LinAlgError("innovation covariance is not positive definite")
        gain[row], nis[row] = solved[:, :states].T, residual[row] @ solved[:, states]
        turn[row], turn_noise[row], turn_root[row] = _whitened(by_turn, solved[:, states:], noise)
    return RowsCompared(residual, covariance, nis, gain, turn, turn_noise, turn_root)


def _whitened(by_turn: FloatArray, solved: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Turn, share of the noise and root of the covariance of :class:`RowsCompared`, for one row.

    Args:
        by_turn: shape (m, 3).
        solved: inverse covariance of the residual times the residual and times ``by_turn``, shape (m, 4).
        noise: covariance of the measurement's own noise, shape (m, m).
    """
    seen = by_turn.T @ solved
    values, vectors = np.linalg.eigh(seen[:, 1:])
    # A turn that the measurement does not show has no information: it counts for nothing, instead of for infinity.
    shown = values > 1e-9 * values[-1]
    # The symmetric root: whitened turns of successive measurements keep their directions.
    inverse_root = (vectors * np.where(shown, 1.0 / np.sqrt(np.where(shown, values, 1.0)), 0.0)) @ vectors.T
    weights = solved[:, 1:] @ inverse_root
    return inverse_root.T @ seen[:, 0], weights.T @ noise @ weights, inverse_root


def update_rows(
    parts: FloatArray, measurement: LinearMeasurement, compared: RowsCompared, learns: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Corrections, shape (h, n), and covariances by source after a measurement.

    The update has Joseph's form, which is right for any gain: that of a row that learns only some states too.

    Args:
        parts: before, shape (h, n_sources, n, n).
        measurement: as compared.
        compared: by :func:`compare_rows`.
        learns: which states each row learns of it; none where the row refuses it, shape (h, n).

    Example:
        Of two states with a variance of 4 each, the sum is measured with the sigma 1. The second row learns only of the
        second state; what it knows of the first one stays, but it knows now how the two go together:

        >>> parts = np.tile(4.0 * np.eye(2), (2, 1, 1, 1))
        >>> measured = LinearMeasurement(np.array([9.0]), np.array([[1.0, 1.0]]), {0: np.array([[1.0]])})
        >>> found = compare_rows(np.zeros((2, 2)), parts, measured, np.zeros(2), np.array([[1.0, 0.0, 0.0]]))
        >>> corrections, after = update_rows(parts, measured, found, np.array([[True, True], [False, True]]))
        >>> print(corrections, after[1, 0].round(3).tolist())
        [[4. 4.]
         [0. 4.]] [[4.0, -1.778], [-1.778, 2.222]]
    """
    rows, sources, states, _ = parts.shape
    gain = np.where(learns[:, :, None], compared.gain, 0.0)
    keep_transposed = (np.eye(states) - gain @ measurement.jacobian).transpose(0, 2, 1)
    # Both products take all sources of a row at once; between them the symmetric parts are transposed.
    halfway = (parts.reshape(rows, sources * states, states) @ keep_transposed).reshape(parts.shape)
    halfway = np.ascontiguousarray(halfway.swapaxes(-1, -2)).reshape(rows, sources * states, states)
    updated = (halfway @ keep_transposed).reshape(parts.shape)
    for source_index, noise in measurement.noise_by_source.items():
        updated[:, source_index] += gain @ noise @ gain.transpose(0, 2, 1)
    updated = 0.5 * (updated + updated.swapaxes(-1, -2))
    corrections: FloatArray = (gain @ compared.residual[:, :, None])[:, :, 0]
    return corrections, updated
