"""The protection levels published last, and their coverage of later outputs.

A protection level belongs to one output. The levels of the following outputs are mostly the same, so levels are
published only once a period. Levels are also published before an output that the published levels do not cover. Such an
output has larger levels, another integrity state or other excluded sources.
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ship_estimation.integrity.protection_levels import IntegrityReport
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_innovations

MAX_LEVEL_RATIO = 1.05
"""Ratio by which an output's protection level may exceed the published level before a new report is due."""

_MAX_LEVEL_SIGMAS = 2.0
"""Upper bound of a protection level, in units of K_fa σ_i, for K_md,i ≤ K_fa: K_fa σ(d_i) + K_md,i σ_i ≤ 2 K_fa σ_i."""
_TINY = 1e-12


class LevelledEstimate(Protocol):
    """An output with its stamp and the covariance of its error, rad², shape (3, 3)."""

    time_ns: int
    covariance_n: FloatArray


class PublishedLevels:
    """The protection levels published last, and the bounds within which following outputs need no new computation.

    The levels of two outputs from the same filter state differ by the growth of the covariance between them, and by the
    rotation of the directions in which the errors are measured.

    Attributes:
        report: report published last; None before the first report.
        state: filter state of the last output that was evaluated.
        redundancy_key: further attributes of that output, such as its sources; an output with other attributes is
            evaluated.
        directions: direction cosines, at that output, of the components whose errors are bounded, shape (k, l).
        until_ns: stamp from which the next report is due.
        max_variance: maximum trace of the covariance of an output that the published levels cover, rad².
        max_direction_change: maximum change of each direction cosine for an output that the published levels cover.

    Example:
        >>> from types import SimpleNamespace
        >>> from ship_estimation.integrity.protection_levels import IntegrityReport, IntegrityState
        >>> output = SimpleNamespace(time_ns=0, covariance_n=np.eye(3))
        >>> def levels(size):
        ...     state = IntegrityState.NO_LIMIT
        ...     return IntegrityReport(0, state, np.full(3, size), ("ins",), np.zeros(1), 5.0, (), "ins", 1.0)
        >>> published = PublishedLevels()
        >>> [published.needs_update(output, levels(size), period_ns=10**9) for size in (10.0, 10.4, 9.0, 10.6, 11.0)]
        [True, False, False, True, False]

        The published level of 10.6 covers levels up to 11.1, so the last level, 11.0, may grow by 1.2 %. Half of this
        growth is allocated to the variance, half to a rotation of the directions.

        >>> print(round(published.max_variance, 3), round(published.max_direction_change, 4))
        3.012 0.0065
    """

    def __init__(self) -> None:
        self.report: IntegrityReport | None = None
        self.state: Any = None
        self.redundancy_key: tuple[Any, ...] = ()
        self.directions: FloatArray = np.empty((0, 0))
        self.until_ns, self.max_variance, self.max_direction_change = 0, 0.0, 0.0

    def covered_count(self, times_ns: NDArray[np.int64], covariances_n: FloatArray, directions: FloatArray) -> int:
        """Return the number of outputs, from the first of N on, that the published levels cover without computation.

        Args:
            times_ns: stamps of the outputs, which are from the same filter state, shape (N,).
            covariances_n: error covariances of the outputs, rad², shape (N, 3, 3).
            directions: direction cosines of each output, shape (N, k, l).
        """
        until, published = (self.until_ns, self.max_variance), (self.directions, self.max_direction_change)
        count: int = compiled_innovations.covered_count(times_ns, covariances_n, directions, *until, *published)
        return count

    def needs_update(self, output: LevelledEstimate, report: IntegrityReport, period_ns: int) -> bool:
        """True if the levels of an output must be published before the output; these levels are then stored.

        Args:
            output: the output.
            report: protection levels of the output.
            period_ns: maximum time between two reports, ns.
        """
        published = self.report
        if (
            published is not None
            and output.time_ns < self.until_ns
            and report.state is published.state
            and report.excluded == published.excluded
        ):
            covers, self.max_variance, self.max_direction_change = _coverage(output, report, published)
            if covers:
                return False
        self.report, self.until_ns = report, output.time_ns + period_ns
        _, self.max_variance, self.max_direction_change = _coverage(output, report, report)
        return True


def _coverage(
    output: LevelledEstimate, report: IntegrityReport, published: IntegrityReport
) -> tuple[bool, float, float]:
    """Return True if published levels cover an output, and the bounds of variance and rotation for later outputs."""
    entering = _MAX_LEVEL_SIGMAS * report.threshold * report.largest_sigma
    found: tuple[bool, float, float] = compiled_innovations.coverage(
        report.level, published.level, output.covariance_n, entering, MAX_LEVEL_RATIO, _TINY
    )
    return found
