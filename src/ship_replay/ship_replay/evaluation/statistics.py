"""Statistics of errors against the truth and of innovations, by source, with their predicted covariance.

An error is estimate minus truth of the three channels of an orientation. The normalised error squared is computed from
the small rotation vector in the horizon frame and its covariance (ship_geometry's glossary).
"""

import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.fft import next_fast_len
from scipy.stats import chi2

from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_estimation.innovations.gates import normalized_error_squared
from ship_estimation.rejection_rules import Reason
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_watch.orientations import Orientation

WINDOW_S = 60
"""Length of the windows for the mean NIS, s."""

_LEAST_WINDOW_SAMPLES = 10
_BAND = 0.999

_WINDOW_TIMES = 5.0
"""Length of the sum over an autocorrelation, in autocorrelation times."""


@dataclass(frozen=True)
class AttitudeErrors:
    """Errors of one source of an orientation.

    Attributes:
        label: name of the source, for example ``fused``, ``ins``, ``star.<id>``, ``pointing`` or ``pointing.<mode>``.
        channels: names of the three errors.
        time_ns: stamps, shape (n,).
        error_arcsec: estimate - truth of the channels, shape (n, 3).
        sigma_arcsec: predicted standard deviations, shape (n, 3); NaN if not given.
        nees: normalised error squared of the rotation vector (3 degrees of freedom), shape (n,); NaN without sigma.
    """

    label: str
    channels: tuple[str, str, str]
    time_ns: np.ndarray
    error_arcsec: FloatArray
    sigma_arcsec: FloatArray
    nees: FloatArray

    def since(self, start_ns: int) -> "AttitudeErrors":
        """Return the errors stamped at or after a time."""
        return self.select(self.time_ns >= start_ns, self.label)

    def select(self, kept: np.ndarray, label: str) -> "AttitudeErrors":
        """Return the errors selected by a mask of shape (n,), under a new label."""
        return replace(
            self,
            label=label,
            time_ns=self.time_ns[kept],
            error_arcsec=self.error_arcsec[kept],
            sigma_arcsec=self.sigma_arcsec[kept],
            nees=self.nees[kept],
        )

    def statistics(self) -> dict[str, float]:
        """Return quantity → value: RMS, bias, predicted sigma and RMS/sigma by channel, mean NEES, sample count."""
        values: dict[str, float] = {"samples": float(len(self.time_ns))}
        for axis, name in enumerate(self.channels):
            error, sigma = self.error_arcsec[:, axis], self.sigma_arcsec[:, axis]
            values[f"{name}.rms_arcsec"] = root_mean_square(error)
            values[f"{name}.bias_arcsec"] = float(np.mean(error))
            values[f"{name}.sigma_arcsec"] = root_mean_square(sigma)
            values[f"{name}.rms_over_sigma"] = root_mean_square(error / sigma)
        values["nees_mean"] = float(np.mean(self.nees))
        return values

    def independent_count(self) -> float:
        """Return the equivalent number of independent errors among those with NEES, see :func:`independent_count`."""
        known = np.isfinite(self.nees)
        return independent_count((self.error_arcsec / self.sigma_arcsec)[known])


def json_values(values: Mapping[str, float]) -> dict[str, float | None]:
    """Return quantities for JSON, with None in place of NaN and infinity."""
    return {name: float(value) if math.isfinite(value) else None for name, value in values.items()}


def json_text(values: Mapping[str, float]) -> str:
    """Return quantities as JSON; null where a value is undefined."""
    return json.dumps(json_values(values), indent=1) + "\n"


def independent_count(normalised: FloatArray) -> float:
    """Return the equivalent number of independent errors in a series of correlated errors.

    The mean of n correlated squares has the variance of a mean of n / τ independent squares. Here τ = 1 + 2 Σ r_k is
    the integrated autocorrelation time, and r_k the autocorrelation of the squares. For Gaussian errors r_k is the
    square of the autocorrelation of the errors (Isserlis 1918). This autocorrelation is estimated far better than r_k
    itself, because the mean of the errors is known to be zero. With r_k estimated from the squares, τ is too short if
    errors last for minutes, and one correct sigma in fifty is rejected. The sum ends at the first lag that is at least
    five times the τ summed up to this lag (automatic windowing, Sokal 1997, "Monte Carlo methods in statistical
    mechanics", section 3).

    Args:
        normalised: errors over their sigmas, equally spaced in time, shape (n, k).

    Returns:
        Number from 1 to n; 0 without samples. Nearly constant errors count as one or two independent errors.
    """
    count = len(normalised)
    if count < 2:
        return float(count)
    length = next_fast_len(2 * count, real=True)
    spectrum = np.abs(np.fft.rfft(normalised, length, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum, length, axis=0)[:count]
    with np.errstate(invalid="ignore"):  # all errors may be zero
        correlation = np.mean((covariance[1:] / covariance[0]) ** 2, axis=1)
    times = 1.0 + 2.0 * np.cumsum(correlation)
    ended = np.flatnonzero(np.arange(1, count) >= _WINDOW_TIMES * times)
    time = times[ended[0]] if len(ended) else times[-1]
    return float(np.clip(count / time, 1.0, count)) if np.isfinite(time) else 1.0


def attitude_errors(
    label: str,
    orientation: Orientation,
    time_ns: np.ndarray,
    estimate_nd: FloatArray,
    truth_nd: FloatArray,
    covariance_n: FloatArray,
) -> AttitudeErrors:
    """Return the errors of attitudes against the truth.

    Args:
        label: name of the source.
        orientation: the orientation.
        time_ns: stamps, shape (n,).
        estimate_nd: estimated rotation horizon from deck or main frame, shape (n, 3, 3).
        truth_nd: true rotation horizon from deck or main frame, shape (n, 3, 3).
        covariance_n: covariance of the rotation vector (North, Up, East), rad², shape (n, 3, 3); NaN or zero if
            unknown.
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
    """Return the mask, shape (n,), of the matrices, shape (n, 3, 3), that are finite and positive definite."""
    finite = np.all(np.isfinite(matrices), axis=(-2, -1))
    eigenvalues = np.linalg.eigvalsh(np.where(finite[:, None, None], matrices, 0.0))
    positive: np.ndarray = finite & (eigenvalues[:, 0] > 0.0)
    return positive


def root_mean_square(values: FloatArray | list[float]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


@dataclass(frozen=True)
class AcceptedInnovation:
    """Innovation of an accepted measurement.

    Attributes:
        components: names of the residual's components; for single stars the axis only, without the star's name.
        residual: residual of each component, rad; NaN if not measured.
        sigma: predicted standard deviation of each residual, rad.
        nis: normalised innovation squared.
    """

    components: tuple[str, ...]
    residual: FloatArray
    sigma: FloatArray
    nis: float


@dataclass
class SourceInnovations:
    """Innovations of one source; a revised decision replaces the earlier decision in ``accepted``.

    Attributes:
        accepted: stamp → innovation of the accepted measurement.
        rejected: reason → number of rejections of measurements, and of their parts such as single stars.
    """

    accepted: dict[int, AcceptedInnovation] = field(default_factory=dict)
    rejected: Counter[str] = field(default_factory=Counter)

    def since(self, start_ns: int) -> "SourceInnovations":
        """Return the innovations stamped at or after a time, with the rejections of the whole run."""
        kept = {stamp_ns: value for stamp_ns, value in self.accepted.items() if stamp_ns >= start_ns}
        return SourceInnovations(kept, self.rejected)

    def components(self) -> list[str]:
        """Return the names of all components, in order of their first occurrence."""
        return list(dict.fromkeys(name for innovation in self.accepted.values() for name in innovation.components))

    def series(self, component: str) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """Return stamps (ns), measured residuals and sigmas (rad) of a component, in order of stamps."""
        rows = [
            (stamp_ns, residual, sigma)
            for stamp_ns, innovation in sorted(self.accepted.items())
            for name, residual, sigma in zip(innovation.components, innovation.residual, innovation.sigma, strict=True)
            if name == component and np.isfinite(residual)
        ]
        stamps = np.array([row[0] for row in rows], dtype=np.int64)
        return stamps, np.array([row[1] for row in rows]), np.array([row[2] for row in rows])

    def statistics(self) -> dict[str, float]:
        """Return quantity → value: counts, mean and standard deviation of each residual, NIS."""
        values = {"accepted": float(len(self.accepted)), "refused": float(sum(self.rejected.values()))}
        for name in self.components():
            _, residual, sigma = self.series(name)
            if len(residual):
                values[f"{name}.mean_arcsec"] = float(np.mean(residual)) / ARCSEC
                values[f"{name}.std_arcsec"] = float(np.std(residual)) / ARCSEC
                values[f"{name}.sigma_arcsec"] = float(np.sqrt(np.mean(sigma**2))) / ARCSEC
        if self.accepted:
            time_ns = np.array(sorted(self.accepted), dtype=np.int64)
            nis = np.array([self.accepted[stamp].nis for stamp in time_ns.tolist()])
            degrees = np.array([np.isfinite(self.accepted[stamp].residual).sum() for stamp in time_ns.tolist()])
            values["nis_mean"] = float(np.mean(nis))
            values["nis_degrees"] = float(np.mean(degrees))
            share = windows_in_band(time_ns, nis, degrees)
            if share is not None:
                values["nis_windows_in_band"] = share
        return values


class InnovationCollector:
    """Collector of Innovation messages by source."""

    def __init__(self) -> None:
        self.sources: dict[str, SourceInnovations] = {}

    def add(self, message: Any) -> None:
        """Add a ship_msgs/Innovation."""
        source = self.sources.setdefault(message.source, SourceInnovations())
        stamp_ns = ns_from_stamp(message.header.stamp)
        if message.accepted and len(message.residual):
            axes = tuple(name.rpartition(" ")[2] for name in message.components)
            residual, sigma = np.array(message.residual), np.array(message.sigma)
            source.accepted[stamp_ns] = AcceptedInnovation(axes, residual, sigma, float(message.nis))
            return
        if not message.accepted:
            source.rejected[reason_name(message)] += 1
            if message.reason == message.GATE or message.reason == message.REVISED:
                # This later decision rejects a measurement that was accepted at first.
                source.accepted.pop(stamp_ns, None)


def reason_name(message: Any) -> str:
    """Return the name of an Innovation's reason as in ``input_health``, e.g. ``gate``."""
    known = message.reason in Reason.__members__.values()
    return Reason(message.reason).word if known else f"reason {message.reason}"


def windows_in_band(time_ns: np.ndarray, nis: FloatArray, degrees: np.ndarray) -> float | None:
    """Return the share of one-minute windows whose mean NIS lies in its 99.9 % band.

    Windows with fewer than ten samples do not count; None if no window counts.
    """
    window = (time_ns - time_ns[0]) // (WINDOW_S * NS_PER_S)
    inside = []
    for number in np.unique(window):
        members = window == number
        if np.sum(members) >= _LEAST_WINDOW_SAMPLES:
            tail = 0.5 * (1.0 - _BAND)
            low, high = chi2.ppf([tail, 1.0 - tail], np.sum(degrees[members]))
            inside.append(low <= np.sum(nis[members]) <= high)
    return float(np.mean(inside)) if inside else None
