"""Which protection levels were told last, and whether they still cover what is put out.

A level belongs to one output. The levels of the outputs after it are mostly the same, so that they are told once a
period, and before an output that the last told ones do not cover: its own are larger, or there are none, or another
source is excluded.
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ship_estimation import compiled_integrity
from ship_estimation.protection import IntegrityReport
from ship_geometry.rotations import FloatArray

MOST_GROWTH = 1.05
"""So many times the levels told last an output's own may be without being told."""

_SIGMAS = 2.0
"""A level is at most so many times its threshold, in sigmas of an estimate without a source."""
_TINY = 1e-12


class LevelledEstimate(Protocol):
    """What is asked of an output: its stamp, and the covariance of its error."""

    time_ns: int
    covariance_n: FloatArray


class ToldLevels:
    """The levels told last, and up to which outputs they need not be computed again.

    The levels of two outputs that rest on one state of a filter differ by what the covariance has grown between them,
    and by how far the directions have turned in which they are measured.

    Attributes:
        report: told last; None before.
        state: what the last output that was looked at rests on.
        checked_by: what decides beside it whether there is a level.
        directions: in which the errors of that output are measured, as cosines, shape (k, l).
        until_ns: stamp from which levels are told again whatever they are.
        greatest_variance: trace of an output's covariance up to which the told levels cover it on the same state, rad².
        most_turned: change of each of its directions up to which they do.

    Example:
        >>> from types import SimpleNamespace
        >>> from ship_estimation.protection import IntegrityReport, IntegrityState
        >>> output = SimpleNamespace(time_ns=0, covariance_n=np.eye(3))
        >>> def levels(size):
        ...     state = IntegrityState.NO_LIMIT
        ...     return IntegrityReport(0, state, np.full(3, size), ("ins",), np.zeros(1), 5.0, (), "ins", 1.0)
        >>> told = ToldLevels()
        >>> [told.must_tell(output, levels(size), period_ns=10**9) for size in (10.0, 10.4, 9.0, 10.6, 11.0)]
        [True, False, False, True, False]

        10.6 is told, and 11.0 may still grow by a hundredth: half of it with the variance, half by turning.

        >>> print(round(told.greatest_variance, 3), round(told.most_turned, 4))
        3.012 0.0065
    """

    def __init__(self) -> None:
        self.report: IntegrityReport | None = None
        self.state: Any = None
        self.checked_by: tuple[Any, ...] = ()
        self.directions: FloatArray = np.empty((0, 0))
        self.until_ns, self.greatest_variance, self.most_turned = 0, 0.0, 0.0

    def covered(self, times_ns: NDArray[np.int64], covariances_n: FloatArray, directions: FloatArray) -> int:
        """How many of N outputs on the same state, from the first one on, the told levels cover for certain.

        Args:
            times_ns: stamps, shape (N,).
            covariances_n: of their errors, rad², shape (N, 3, 3).
            directions: of each as in the attributes, shape (N, k, l).
        """
        until, told = (self.until_ns, self.greatest_variance), (self.directions, self.most_turned)
        count: int = compiled_integrity.covered(times_ns, covariances_n, directions, *until, *told)
        return count

    def must_tell(self, output: LevelledEstimate, report: IntegrityReport, period_ns: int) -> bool:
        """Whether the levels of an output are to be told before it; they are the last told ones then.

        Args:
            output: the output.
            report: its levels.
            period_ns: so often they are told in any case.
        """
        told = self.report
        if told is not None and output.time_ns < self.until_ns and _as_told(report, told):
            covers, self.greatest_variance, self.most_turned = _coverage(output, report, told)
            if covers:
                return False
        self.report, self.until_ns = report, output.time_ns + period_ns
        _, self.greatest_variance, self.most_turned = _coverage(output, report, report)
        return True


def _as_told(report: IntegrityReport, told: IntegrityReport) -> bool:
    """Whether a report differs from that told last in numbers alone."""
    return report.state is told.state and report.excluded == told.excluded


def _coverage(output: LevelledEstimate, report: IntegrityReport, told: IntegrityReport) -> tuple[bool, float, float]:
    """Whether told levels cover those of an output, and up to which variance and turn they cover those after it."""
    entering = _SIGMAS * report.threshold * report.widest
    found: tuple[bool, float, float] = compiled_integrity.coverage(
        report.level, told.level, output.covariance_n, entering, MOST_GROWTH, _TINY
    )
    return found
