"""Detection of an error that all star sensors share, from the sum of the filter's corrections.

A wrong position, a step of UTC or a rotation of the deck changes all star measurements in the same way. The star
sensors remain consistent with one another and become inconsistent only with the INS, which drifts. The filter follows
the stars within its time constant; afterwards no innovation shows the error.

Without such an error the corrections by successive measurements are independent. The covariance of a correction is the
decrease of the state covariance due to its measurement. The sum of the corrections over a window is the solution
separation from a filter without the stars of that window (see :mod:`ship_estimation.integrity.protection_levels`). The
covariances of the corrections add up to the covariance of the separation. The window is two time constants of the
filter long. Within this window the filter absorbs 78 to 86 % of a common error, and the drift of the INS is small.
"""

import math
from typing import NamedTuple

import numpy as np

from ship_estimation.fault_detection.isolation import MEASUREMENTS_PER_H
from ship_estimation.fault_detection.subfilters import FilterInnovations
from ship_estimation.innovations.gates import normal_value_above
from ship_estimation.integrity.protection_levels import IntegrityConfig, ProtectionLevels, SigmaMultipliers
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_innovations

COMMON_ERROR_START_SIGMAS = 4.5
"""Sum of corrections above which the published covariance is inflated, sigmas."""

_BLOCKS = 4
_BLOCK_LEFT = math.exp(-0.5)
"""Share of a common error that remains at the end of a block, which is half a time constant of the filter long."""

_COMPONENTS = 3


class UnresolvedCommonError(NamedTuple):
    """A common error of all stars that is probable, but below the threshold at which the stars are excluded.

    Attributes:
        variance: variance of the attitude due to this error, about North, Up and East, rad², shape (3,).
        until_ns: stamp until which the published covariance contains this error.
    """

    variance: FloatArray
    until_ns: int


class CorrectionSums(NamedTuple):
    """Recent corrections of three states by the star sensors, about North, Up and East.

    Attributes:
        sums: sums over each block of measurements, the newest block first, shape (b, 3, 3). The second axis holds the
            sum of the corrections, rad, the sum of their variances, rad², and the share of a common error that remains
            after the block.
        sigmas: largest ratio of a component of the sum over all blocks to the sigma of this component.
        unresolved: common error that the published covariance contains; None without such an error.
    """

    sums: FloatArray
    sigmas: float
    unresolved: UnresolvedCommonError | None = None

    @property
    def correction_n(self) -> FloatArray:
        """Sum of the corrections about North, Up and East, rad, shape (3,)."""
        rotation_n: FloatArray = self.sums[:, 0].sum(axis=0)
        return rotation_n

    @property
    def variance(self) -> FloatArray:
        """Variance that the sum of the corrections has without a common error, rad², shape (3,)."""
        variance: FloatArray = self.sums[:, 1].sum(axis=0)
        return variance

    @property
    def absorbed_share(self) -> FloatArray:
        """Share of a common error that the corrections have absorbed, shape (3,)."""
        response: FloatArray = 1.0 - self.sums[:, 2].prod(axis=0)
        return response

    @property
    def error_n(self) -> FloatArray:
        """Common error that explains the sum of corrections, rad, shape (3,); that sum if nothing was absorbed."""
        response = self.absorbed_share
        error_n: FloatArray = self.correction_n / np.where(response > 0.0, response, 1.0)
        return error_n

    @property
    def error_variance(self) -> FloatArray:
        """Variance of the common error :attr:`error_n`, rad², shape (3,); infinite if nothing was absorbed."""
        response = self.absorbed_share
        is_known = response > 0.0
        variance: FloatArray = np.where(is_known, self.variance / np.where(is_known, response, 1.0) ** 2, np.inf)
        return variance

    def with_correction(self, innovations: FilterInnovations, jacobian: FloatArray, first: int) -> "CorrectionSums":
        """Return the sums after one more measurement of a star sensor.

        Args:
            innovations: innovations of the measurement, with which the main filter was updated.
            jacobian: Jacobian of the measurement, shape (m, n).
            first: index of the first of the three states.

        Example:
            A sensor and a state with sigma 1 each; half of each residual becomes a correction:

            >>> gain, one = 0.5 * np.eye(3)[None], np.eye(3)[None]
            >>> innovations = FilterInnovations(np.full((1, 3), 4.0), 2.0 * one, np.ones(1), gain, *(np.empty(0),) * 3)
            >>> found = NO_CORRECTIONS.with_correction(innovations, np.eye(3), first=0)
            >>> print(found.correction_n, found.variance, found.absorbed_share, round(found.sigmas, 2))
            [2. 2. 2.] [0.5 0.5 0.5] [0.5 0.5 0.5] 2.83
        """
        sums, sigmas = compiled_innovations.updated_correction_sums(
            self.sums, innovations.gain, innovations.residual, innovations.covariance, jacobian, first, _BLOCK_LEFT
        )
        return CorrectionSums(sums, sigmas, self.unresolved)

    def without_corrections(self) -> "CorrectionSums":
        """Return the sums with corrections of zero, for a filter state that did not result from these measurements."""
        sums = self.sums.copy()
        sums[:, 0] = 0.0
        return CorrectionSums(sums, 0.0, self.unresolved)

    def unresolved_variance(self) -> FloatArray:
        """Return the variance that covers an unresolved common error, rad², shape (3,).

        The variance is zero for an error of up to :data:`COMMON_ERROR_START_SIGMAS` and grows continuously above, as in
        :func:`ship_estimation.integrity.protection_levels.separation_inflation`.

        Example:
            >>> sums = np.zeros((1, 3, 3))
            >>> sums[0] = [[5.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]
            >>> print(CorrectionSums(sums, 5.0).unresolved_variance())
            [4.75 0.   0.  ]
        """
        limit = COMMON_ERROR_START_SIGMAS**2 * self.error_variance
        found: FloatArray = np.where(np.isfinite(limit), np.maximum(self.error_n**2 - limit, 0.0), 0.0)
        return found

    def with_unresolved_error(self, time_ns: int, hold_ns: int) -> "CorrectionSums":
        """Return the sums with the unresolved common error at a time.

        The filter follows a common error within seconds, and then the sum is small again. The published covariance must
        contain the error longer, so the error is held for ``hold_ns``.

        Args:
            time_ns: stamp of the last correction.
            hold_ns: time for which an error is held after the last sum above :data:`COMMON_ERROR_START_SIGMAS`, ns.
        """
        before = self.unresolved if self.unresolved is not None and time_ns < self.unresolved.until_ns else None
        if not self.sigmas > COMMON_ERROR_START_SIGMAS:
            return self._replace(unresolved=before)
        variance = self.unresolved_variance()
        if before is not None:
            variance = np.maximum(variance, before.variance)
        return self._replace(unresolved=UnresolvedCommonError(variance, time_ns + hold_ns))


NO_CORRECTIONS = CorrectionSums(np.tile(np.array([0.0, 0.0, 1.0])[:, None], (_BLOCKS, 1, _COMPONENTS)), 0.0)
"""Sums before any measurement."""


def common_threshold(config: IntegrityConfig) -> float:
    """Return the threshold of a sum of corrections above which all star sensors are inconsistent with the INS, sigmas.

    The test adds at most a quarter of the configured rate of false exclusions. The quarter is allocated equally to the
    three components of each measurement in an hour, as if all sums were independent.

    Example:
        >>> print(round(common_threshold(IntegrityConfig()), 2))
        5.86
    """
    tests_per_h = _COMPONENTS * MEASUREMENTS_PER_H
    return normal_value_above(0.125 * config.false_exclusions_per_h / tests_per_h)


def with_common_error(
    found: ProtectionLevels,
    k: SigmaMultipliers,
    missed_detection: float,
    threshold: float,
    corrections: CorrectionSums,
    by_states: FloatArray,
    covariance: FloatArray,
) -> ProtectionLevels:
    """Return the protection levels of an output with a common error of all stars as an additional, last hypothesis.

    If the sum of corrections is within its threshold, the separation from the filter without the stars of the window is
    within that threshold. The error of that filter is within ``missed_detection`` times its sigma.

    Args:
        found: protection levels with all other hypotheses.
        k: sigma multipliers of ``found``.
        missed_detection: multiplier K_md of the common error hypothesis.
        threshold: threshold of the sum of corrections (:func:`common_threshold`), sigmas.
        corrections: recent corrections by all stars.
        by_states: Jacobian of the output components with respect to the errors about North, Up and East, shape (3, 3).
        covariance: covariance of the output components in the main filter, rad², shape (3, 3).

    Example:
        The corrections determine a common error with a sigma of 2″; each output component has a sigma of 1″:

        >>> sums, every = np.zeros((1, 3, 3)), np.eye(3)
        >>> sums[0, 1] = 4.0
        >>> k = SigmaMultipliers(fault_free=6.0, false_exclusion=5.0, missed_detection=np.array([2.0]))
        >>> others = ProtectionLevels(np.array([1.0]), np.full(3, 8.0), 0, 1.0)

        >>> found = with_common_error(others, k, 1.0, 6.0, CorrectionSums(sums, 3.0), every, every)
        >>> print(found.statistic, found.level.round(1), found.dominant)
        [1.  2.5] [14.2 14.2 14.2] 1
    """
    variance, level = corrections.error_variance.tolist(), []
    for by_state, own in zip(np.square(by_states).tolist(), covariance.diagonal().tolist(), strict=True):
        # Factors of zero are skipped, because zero times the infinite variance of an unknown error would be NaN.
        of_error = sum(square * one for square, one in zip(by_state, variance, strict=True) if square)
        level.append(threshold * math.sqrt(of_error) + missed_detection * math.sqrt(own + of_error))
    # The report has one threshold for all statistics, K_fa; this statistic is scaled from its own threshold to K_fa.
    statistic = np.append(found.statistic, corrections.sigmas * k.false_exclusion / threshold)
    largest = found.level.max()
    is_largest = not all(one <= largest for one in level)  # NaN is the largest
    return found._replace(
        statistic=statistic,
        level=np.maximum(found.level, level),
        dominant=len(found.statistic) if is_largest else found.dominant,
    )
