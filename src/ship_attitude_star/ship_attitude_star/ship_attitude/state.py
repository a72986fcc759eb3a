"""State of the ship-attitude filter after a measurement.

A :class:`FilterState` is immutable, so the time-ordered log can store states and go back to any of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ship_attitude_star.plausibility.diagnosis_hints import AttitudeResidual
from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_estimation.fault_detection.common_error import NO_CORRECTIONS, CorrectionSums
from ship_estimation.fault_detection.fault_state import FaultState
from ship_estimation.fault_detection.unconfirmed_step import UnconfirmedStep
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_kalman
from ship_stars.camera.spatial_errors import PixelDwell


class SourceInnovation(NamedTuple):
    """Innovation of a source's measurement against the main filter, as a rotation of the device.

    Attributes:
        whitened: whitened rotation vector (unit covariance), shape (3,).
        root: root of the covariance of the rotation vector, rad, shape (3, 3).
        predicted_nv: predicted attitude of the device, horizon from device, shape (3, 3).
    """

    whitened: FloatArray
    root: FloatArray
    predicted_nv: FloatArray

    @property
    def rotation_v(self) -> FloatArray:
        """Rotation vector in the device frame, rad, shape (3,)."""
        rotation_v: FloatArray = self.root @ self.whitened
        return rotation_v

    @property
    def rotation_n(self) -> FloatArray:
        """Rotation vector in the horizon frame, rad, shape (3,)."""
        rotation_n: FloatArray = self.predicted_nv @ self.rotation_v
        return rotation_n


def shared_rotation(innovations: Sequence[SourceInnovation]) -> FloatArray:
    """Return the rotation common to several innovations by least squares.

    Returns:
        Rotation vector in the horizon frame, rad, shape (3,).
    """
    whitening = np.vstack([np.linalg.pinv(one.root) @ one.predicted_nv.T for one in innovations])
    whitened = np.concatenate([one.whitened for one in innovations])
    rotation_n: FloatArray = np.linalg.lstsq(whitening, whitened, rcond=None)[0]
    return rotation_n


class UtcStep(NamedTuple):
    """A step of the time base after which UTC must be verified.

    Attributes:
        step_s: sum of the steps since UTC was last verified, s.
        log_likelihood_ratio: log-likelihood of the star measurements since the last step if the sky is rotated by
            ``step_s``, minus the log-likelihood if the sky is not rotated.
    """

    step_s: float
    log_likelihood_ratio: float = 0.0


class RecentInnovations(NamedTuple):
    """Windowed innovation means of a source's accepted measurements against the main filter.

    Attributes:
        windowed_means: the windowed means, as in
            :attr:`~ship_estimation.fault_detection.innovation_means.InnovationMeans.running`, shape (w, 5).
        largest_sigmas: largest deviation of a mean from zero, in standard deviations of the mean.
    """

    windowed_means: FloatArray
    largest_sigmas: float


NO_PIXEL_DWELLS: MappingProxyType[str, PixelDwell] = MappingProxyType({})
"""Pixel dwells before any exposure."""


@dataclass(frozen=True)
class FilterState(FaultState):
    """State of h filters, the main filter first, then the subfilters.

    Attributes:
        time_ns: time of the state; None before the first measurement.
        means: estimated errors, shape (h, n).
        stack: covariance of the main filter by error source, then covariances of the subfilters, as in
            :mod:`ship_estimation.fault_detection.subfilters`, shape (n_sources + h - 1, n, n).
        exclusion_counts: number of exclusions of each source.
        separation_covariance_n: covariance that an output adds for large solution separations and for an earlier error
            shared by the stars, rad², horizon frame, shape (3, 3); not part of ``stack``; None if neither exists.
        last_innovations: innovation of each source's last measurement against the main filter.
        recent_innovations: windowed innovation means of each source's accepted measurements since the last restart of
            the filters.
        received_since_ns: stamp since which each source has been received without a gap, ns.
        common_n: steady-state covariance of the correlated error of each star sensor, rad², horizon frame, shape
            (3, 3).
        consecutive_rejections: number of consecutive rejections of each source.
        last_used_ns: stamp of each source's last accepted measurement, ns.
        pixel_dwells: pixel dwell of the stars in each camera; emptied if the covariance is inflated for an INS jump or
            for consecutive rejections.
        unconfirmed_step: INS jump, possible INS jump, reinstatement of the INS or first star measurement that other
            stars have not confirmed; None if all are confirmed.
        rejected_residuals: residual of each source's last rejected measurement.
        ins_jump_ns: INS stamp just before the first sample after the last jump for which the covariance was inflated;
            None before a jump.
        ins_fault_ns: time of the last reported jump, a later contradiction, or a reinstatement of the INS; None before
            these.
        vertical: vertical at the time of the state; None before the first measurement, or if the filter needs no
            vertical.
        utc_step: step of the time base after which UTC is not verified yet; None otherwise.
        correction_sums: sums of the recent corrections by the star sensors, which show an error that all star sensors
            share.
    """

    time_ns: int | None
    means: FloatArray
    stack: FloatArray
    exclusion_counts: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    last_innovations: MappingProxyType[str, SourceInnovation] = field(default_factory=lambda: MappingProxyType({}))
    recent_innovations: MappingProxyType[str, RecentInnovations] = field(default_factory=lambda: MappingProxyType({}))
    received_since_ns: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    common_n: MappingProxyType[str, FloatArray] = field(default_factory=lambda: MappingProxyType({}))
    consecutive_rejections: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    last_used_ns: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    pixel_dwells: MappingProxyType[str, PixelDwell] = field(default_factory=lambda: NO_PIXEL_DWELLS)
    unconfirmed_step: UnconfirmedStep | None = None
    rejected_residuals: MappingProxyType[str, AttitudeResidual] = field(default_factory=lambda: MappingProxyType({}))
    ins_jump_ns: int | None = None
    ins_fault_ns: int | None = None
    separation_covariance_n: FloatArray | None = None
    vertical: LocalVertical | None = None
    utc_step: UtcStep | None = None
    correction_sums: CorrectionSums = NO_CORRECTIONS

    @property
    def mean(self) -> FloatArray:
        """Estimated errors of the main filter, shape (n,)."""
        mean: FloatArray = self.means[0]
        return mean

    @property
    def covariance_by_source(self) -> FloatArray:
        """Covariance of the main filter by error source, shape (n_sources, n, n)."""
        parts: FloatArray = self.stack[: len(self.stack) - len(self.means) + 1]
        return parts

    def has_used(self, source: str) -> bool:
        """True if a measurement of the source was accepted, even if the source was excluded since."""
        return source in self.last_used_ns or source in self.exclusion_counts

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the main filter, shape (n, n)."""
        total: FloatArray = compiled_kalman.total(self.stack, len(self.stack) - len(self.means) + 1)
        return total
