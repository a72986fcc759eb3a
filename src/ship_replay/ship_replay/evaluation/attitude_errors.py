"""Errors of attitudes against the truth, and what they say about the predicted covariance.

An error is estimate minus truth of the three channels of an orientation; for the normalised error squared it is the
small rotation vector in the horizon frame, as its covariance is (ship_geometry's glossary).
"""

from dataclasses import dataclass, replace

import numpy as np

from ship_estimation.gates import normalized_error_squared
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_replay.offline.orientations import Orientation


@dataclass(frozen=True)
class AttitudeErrors:
    """Errors of one source of an orientation.

    Attributes:
        label: ``fused``, ``ins``, ``star.<id>``, ``pointing`` or ``pointing.<mode>``.
        channels: names of the three errors.
        time_ns: stamps, shape (n,).
        error_arcsec: estimate - truth of the channels, shape (n, 3).
        sigma_arcsec: predicted standard deviations, shape (n, 3); NaN where none was given.
        nees: normalised error squared of the rotation vector (3 degrees of freedom), shape (n,); NaN likewise.
    """

    label: str
    channels: tuple[str, str, str]
    time_ns: np.ndarray
    error_arcsec: FloatArray
    sigma_arcsec: FloatArray
    nees: FloatArray

    def since(self, start_ns: int) -> "AttitudeErrors":
        """The errors stamped at or after a time."""
        return self.where(self.time_ns >= start_ns, self.label)

    def where(self, kept: np.ndarray, label: str) -> "AttitudeErrors":
        """Some of the errors, chosen by booleans of shape (n,), under a name of their own."""
        return replace(
            self,
            label=label,
            time_ns=self.time_ns[kept],
            error_arcsec=self.error_arcsec[kept],
            sigma_arcsec=self.sigma_arcsec[kept],
            nees=self.nees[kept],
        )

    def statistics(self) -> dict[str, float]:
        """Quantity → value: RMS, bias, predicted sigma and RMS/sigma per channel, mean NEES, number of samples."""
        values: dict[str, float] = {"samples": float(len(self.time_ns))}
        for axis, name in enumerate(self.channels):
            error, sigma = self.error_arcsec[:, axis], self.sigma_arcsec[:, axis]
            values[f"{name}.rms_arcsec"] = _root_mean_square(error)
            values[f"{name}.bias_arcsec"] = float(np.mean(error))
            values[f"{name}.sigma_arcsec"] = _root_mean_square(sigma)
            values[f"{name}.rms_over_sigma"] = _root_mean_square(error / sigma)
        values["nees_mean"] = float(np.mean(self.nees))
        return values


def attitude_errors(
    label: str,
    orientation: Orientation,
    time_ns: np.ndarray,
    estimate_nd: FloatArray,
    truth_nd: FloatArray,
    covariance_n: FloatArray,
) -> AttitudeErrors:
    """Errors of attitudes at known truth.

    Args:
        label: name of the source.
        orientation: what it is an attitude of.
        time_ns: stamps, shape (n,).
        estimate_nd: horizon from deck, shape (n, 3, 3).
        truth_nd: horizon from deck, shape (n, 3, 3).
        covariance_n: of the rotation vector (North, Up, East), rad², shape (n, 3, 3); NaN or zero where unknown.
    """
    angles = angles_from_rotation(estimate_nd)
    vector_n = log_rotation(truth_nd @ np.swapaxes(estimate_nd, -1, -2))
    known = _is_covariance(covariance_n)
    variances = np.full((len(time_ns), 3), np.nan)
    nees = np.full(len(time_ns), np.nan)
    if np.any(known):
        covariance_angles = angle_covariance(covariance_n[known], angles[known, 0], angles[known, 1])
        variances[known] = np.diagonal(covariance_angles, axis1=-2, axis2=-1)
        nees[known] = normalized_error_squared(vector_n[known], covariance_n[known])
    errors_arcsec = orientation.errors_arcsec(angles, truth_nd)
    sigmas_arcsec = orientation.scale(angles) * np.sqrt(variances) / ARCSEC
    return AttitudeErrors(label, orientation.channels, time_ns, errors_arcsec, sigmas_arcsec, nees)


def _is_covariance(matrices: FloatArray) -> np.ndarray:
    """Which of the matrices, shape (n, 3, 3), are finite and positive definite; shape (n,)."""
    finite = np.all(np.isfinite(matrices), axis=(-2, -1))
    eigenvalues = np.linalg.eigvalsh(np.where(finite[:, None, None], matrices, 0.0))
    return finite & (eigenvalues[:, 0] > 0.0)


def _root_mean_square(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
