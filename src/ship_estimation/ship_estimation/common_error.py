"""An error that all star sensors share from some time on: its trace in the corrections, and what the data leave of it.

A wrong position, a step of UTC or a turn of the deck changes all star measurements in the same way. No star sensor
contradicts another one then; only the INS does, which wanders by itself. The estimate follows the stars within the time
constant of the filter, and after that nothing contradicts anything.

Without such an error the corrections by successive measurements are independent of one another, with the covariance by
which each makes the estimate better known. So their sum over a window, beside the sum of these covariances, is the
separation of the estimate from the one that does without the stars of that window (solution separation, as in
:mod:`ship_estimation.protection`). The window is two time constants of the filter long: a common error is absorbed to
78 to 86 % in it, and the INS has not wandered farther than need be.
"""

import math
from typing import NamedTuple

import numpy as np

from ship_estimation import compiled_means
from ship_estimation.chi_square import normal_value_above
from ship_estimation.hypotheses import RowsCompared
from ship_estimation.protection import Factors, IntegrityConfig, Separation
from ship_estimation.running_means import MEASUREMENTS_PER_H
from ship_geometry.rotations import FloatArray

SUSPECTED_SIGMAS = 4.5
"""A sum of corrections beyond this is covered by the published covariance."""

_BLOCKS = 4
_BLOCK_LEFT = math.exp(-0.5)
"""Share of a common error that the corrections of one block leave: half a time constant of the filter."""

_COMPONENTS = 3


class Suspicion(NamedTuple):
    """An error that all stars may share: the INS contradicted them, and not so much that they are set aside.

    Attributes:
        variance: of the attitude by it, about North, Up and East, rad², shape (3,).
        until_ns: stamp until which the covariance holds it.
    """

    variance: FloatArray
    until_ns: int


class Absorbed(NamedTuple):
    """Corrections of three states by the star sensors of late, about North, Up and East.

    Attributes:
        sums: by block, the newest first: the sum of the corrections, rad, the sum of their variances, rad², and the
            share of a common error that they leave; shape (b, 3, 3).
        sigmas: the sum over all blocks that is farthest from zero, in its own sigmas.
        suspicion: what the stars may share; None where nothing tells of it.
    """

    sums: FloatArray
    sigmas: float
    suspicion: Suspicion | None = None

    @property
    def turn_n(self) -> FloatArray:
        """Sum of the corrections, rad, shape (3,)."""
        turn_n: FloatArray = self.sums[:, 0].sum(axis=0)
        return turn_n

    @property
    def variance(self) -> FloatArray:
        """Its variance where no error is common to all stars, rad², shape (3,)."""
        variance: FloatArray = self.sums[:, 1].sum(axis=0)
        return variance

    @property
    def response(self) -> FloatArray:
        """Share of a common error that the corrections have absorbed, shape (3,)."""
        response: FloatArray = 1.0 - self.sums[:, 2].prod(axis=0)
        return response

    @property
    def error_n(self) -> FloatArray:
        """Common error that explains the sum, rad, shape (3,); the sum itself where nothing was absorbed."""
        response = self.response
        error_n: FloatArray = self.turn_n / np.where(response > 0.0, response, 1.0)
        return error_n

    @property
    def error_variance(self) -> FloatArray:
        """Variance of the common error that the sum tells, rad², shape (3,); infinite where nothing was absorbed."""
        response = self.response
        is_known = response > 0.0
        variance: FloatArray = np.where(is_known, self.variance / np.where(is_known, response, 1.0) ** 2, np.inf)
        return variance

    def with_correction(self, compared: RowsCompared, jacobian: FloatArray, first: int) -> "Absorbed":
        """The sums after one more measurement of a star sensor.

        Args:
            compared: the measurement with every row; the first row has learnt of it.
            jacobian: of the measurement, shape (m, n).
            first: of the three states.

        Example:
            A sensor with the sigma 1 and a state with the sigma 1; half of each residual becomes a correction:

            >>> gain, one = 0.5 * np.eye(3)[None], np.eye(3)[None]
            >>> compared = RowsCompared(np.full((1, 3), 4.0), 2.0 * one, np.ones(1), gain, *(np.empty(0),) * 3)
            >>> found = NOTHING_ABSORBED.with_correction(compared, np.eye(3), first=0)
            >>> print(found.turn_n, found.variance, found.response, round(found.sigmas, 2))
            [2. 2. 2.] [0.5 0.5 0.5] [0.5 0.5 0.5] 2.83
        """
        sums, sigmas = compiled_means.absorbed(
            self.sums, compared.gain, compared.residual, compared.covariance, jacobian, first, _BLOCK_LEFT
        )
        return Absorbed(sums, sigmas, self.suspicion)

    def without_corrections(self) -> "Absorbed":
        """The sums after the estimate was replaced by another one, which has not followed the same measurements."""
        sums = self.sums.copy()
        sums[:, 0] = 0.0
        return Absorbed(sums, 0.0, self.suspicion)

    def suspected_variance(self) -> FloatArray:
        """Variance that covers a suspected common error, rad², shape (3,).

        It begins from nothing at :data:`SUSPECTED_SIGMAS`, as in :func:`ship_estimation.protection.disputed`.

        Example:
            >>> sums = np.zeros((1, 3, 3))
            >>> sums[0] = [[5.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]
            >>> print(Absorbed(sums, 5.0).suspected_variance())
            [4.75 0.   0.  ]
        """
        limit = SUSPECTED_SIGMAS**2 * self.error_variance
        found: FloatArray = np.where(np.isfinite(limit), np.maximum(self.error_n**2 - limit, 0.0), 0.0)
        return found

    def with_suspicion(self, time_ns: int, hold_ns: int) -> "Absorbed":
        """The sums with what they tell at a time, or told not long before.

        The estimate follows an error that all stars share within seconds. The covariance must hold it longer.

        Args:
            time_ns: stamp of the last correction.
            hold_ns: how long a suspicion lasts after the last sum beyond :data:`SUSPECTED_SIGMAS`.
        """
        before = self.suspicion if self.suspicion is not None and time_ns < self.suspicion.until_ns else None
        if not self.sigmas > SUSPECTED_SIGMAS:
            return self._replace(suspicion=before)
        variance = self.suspected_variance()
        if before is not None:
            variance = np.maximum(variance, before.variance)
        return self._replace(suspicion=Suspicion(variance, time_ns + hold_ns))


NOTHING_ABSORBED = Absorbed(np.tile(np.array([0.0, 0.0, 1.0])[:, None], (_BLOCKS, 1, _COMPONENTS)), 0.0)
"""Before any measurement."""


def common_threshold(config: IntegrityConfig) -> float:
    """Sigmas of a sum of corrections beyond which all star sensors contradict the INS.

    Stars that are right are set aside a quarter as often as a source is excluded that is right; this comes in addition.
    It is shared out to the three components of each measurement of an hour, as if all sums were independent.

    Example:
        >>> print(round(common_threshold(IntegrityConfig()), 2))
        5.86
    """
    tests_per_h = _COMPONENTS * MEASUREMENTS_PER_H
    return normal_value_above(0.125 * config.false_exclusions_per_h / tests_per_h)


def with_common_error(
    found: Separation,
    k: Factors,
    missed: float,
    threshold: float,
    absorbed: Absorbed,
    by_states: FloatArray,
    covariance: FloatArray,
) -> Separation:
    """The separations and levels of an output with those of an error that all stars share, as the last hypothesis.

    Where no sum of corrections is above its threshold, such an error is at most the threshold away from none, and the
    estimate without the stars of the window is right to ``missed`` of its sigmas.

    Args:
        found: by all other hypotheses.
        k: their numbers of sigmas.
        missed: K_md of this hypothesis.
        threshold: of the sum of corrections, by :func:`common_threshold`.
        absorbed: the corrections by all stars of late.
        by_states: the components by the errors about North, Up and East, shape (3, 3).
        covariance: of the components by all sources, shape (3, 3).

    Example:
        The corrections tell a common error to 2″, the output has 1″ in each component:

        >>> sums, every = np.zeros((1, 3, 3)), np.eye(3)
        >>> sums[0, 1] = 4.0
        >>> k = Factors(right=6.0, false_exclusion=5.0, missed=np.array([2.0]))
        >>> others = Separation(np.array([1.0]), np.full(3, 8.0), 0, 1.0)
        >>> found = with_common_error(others, k, 1.0, 6.0, Absorbed(sums, 3.0), every, every)
        >>> print(found.statistic, found.level.round(1), found.dominant)
        [1.  2.5] [14.2 14.2 14.2] 1
    """
    variance, level = absorbed.error_variance.tolist(), []
    for by_state, own in zip(np.square(by_states).tolist(), covariance.diagonal().tolist(), strict=True):
        # What a component does not depend on may be unknown: infinity times zero is no number.
        of_error = sum(square * one for square, one in zip(by_state, variance, strict=True) if square)
        level.append(threshold * math.sqrt(of_error) + missed * math.sqrt(own + of_error))
    # In units of the threshold that all hypotheses of a report are held against.
    statistic = np.append(found.statistic, absorbed.sigmas * k.false_exclusion / threshold)
    largest = found.level.max()
    is_largest = not all(one <= largest for one in level)  # NaN is
    return found._replace(
        statistic=statistic,
        level=np.maximum(found.level, level),
        dominant=len(found.statistic) if is_largest else found.dominant,
    )
