"""Kalman steps on a covariance that is kept as a sum over the sources of error.

The covariance P of a state is carried as ``parts``, shape (n_sources, n, n), with P = parts.sum(axis=0). Both
steps are linear in P (the update in Joseph's form), so each part goes through with the filter's own gain and
the sum stays exact: this is the error budget.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg.lapack as lapack

from ship_geometry.rotations import FloatArray


@dataclass(frozen=True)
class LinearMeasurement:
    """A measurement linearised at the predicted state: residual = jacobian @ error + noise.

    Attributes:
        residual: measured minus predicted, shape (m,).
        jacobian: shape (m, n).
        noise_by_source: covariance of the measurement noise, shape (m, m), by the index of the source that it is
            booked to.
    """

    residual: FloatArray
    jacobian: FloatArray
    noise_by_source: Mapping[int, FloatArray]

    @property
    def noise(self) -> FloatArray:
        """Covariance of the whole measurement noise, shape (m, m)."""
        first, *others = self.noise_by_source.values()
        return sum(others, start=first)


def predict(parts: FloatArray, decay: FloatArray, booked_noise: FloatArray) -> FloatArray:
    """Parts after a step with diagonal transition ``decay`` (n,) and process noise (n_sources, n)."""
    predicted: FloatArray = parts * (decay[:, None] * decay)
    diagonal = np.arange(decay.size)
    predicted[:, diagonal, diagonal] += booked_noise
    return predicted


def innovation(parts: FloatArray, measurement: LinearMeasurement) -> tuple[FloatArray, float]:
    """Innovation covariance, shape (m, m), and normalised innovation squared (chi² with m degrees)."""
    h = measurement.jacobian
    covariance = h @ parts.sum(axis=0) @ h.T + measurement.noise
    _, solution, info = lapack.dposv(covariance, measurement.residual)
    if info != 0:
        raise np.linalg.LinAlgError("innovation covariance is not positive definite")
    return covariance, float(measurement.residual @ solution)


def update(
    parts: FloatArray, measurement: LinearMeasurement, innovation_covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Correction of the state, shape (n,), and the parts after a measurement.

    Args:
        parts: before the measurement, shape (n_sources, n, n).
        measurement: linearised at the predicted state.
        innovation_covariance: as :func:`innovation` gives it.
    """
    h = measurement.jacobian
    cross = h @ parts.sum(axis=0)
    _, gain_transposed, _ = lapack.dposv(innovation_covariance, cross)
    gain = gain_transposed.T
    keep = np.eye(parts.shape[-1]) - gain @ h
    updated: FloatArray = keep @ parts @ keep.T
    for source_index, noise in measurement.noise_by_source.items():
        updated[source_index] += gain @ noise @ gain.T
    updated = 0.5 * (updated + updated.transpose(0, 2, 1))
    return gain @ measurement.residual, updated
