"""Least squares over a whole run, by scipy's sparse solver: the reference of smoothers and filters.

The solver shares no code with the estimators, and computes derivatives by differences.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

Row = tuple[Sequence[slice], Callable[..., np.ndarray]]
"""Slices of the unknowns that a residual depends on, and the function from these unknowns to the residual in sigmas."""


def solve(rows: Sequence[Row], steps: np.ndarray) -> tuple[np.ndarray, object]:
    """Return the unknowns by Gauss-Newton, and the factors of their information matrix.

    Args:
        rows: all residuals.
        steps: step of each unknown for the differences, shape (n,).
    """
    unknowns = np.zeros(len(steps))
    for _ in range(4):
        values, blocks, first = [], [], 0
        for used, residual in rows:
            at = [unknowns[one] for one in used]
            value = residual(*at)
            values.append(value)
            for number, one in enumerate(used):
                for column in range(one.start, one.stop):
                    ends = []
                    for sign in (steps[column], -steps[column]):
                        moved = [part.copy() for part in at]
                        moved[number][column - one.start] += sign
                        ends.append(residual(*moved))
                    slope = (ends[0] - ends[1]) / (2 * steps[column])
                    blocks += [(first + row, column, slope[row]) for row in np.flatnonzero(slope)]
            first += len(value)
        row, column, slope = zip(*blocks, strict=True)
        jacobian = sparse.csc_matrix((slope, (row, column)), shape=(first, len(steps)))
        factors = splu((jacobian.T @ jacobian).tocsc())
        unknowns = unknowns - factors.solve(jacobian.T @ np.concatenate(values))
    return unknowns, factors


def covariance_of(factors: object, size: int, parts: Sequence[slice]) -> np.ndarray:
    """Return the covariance of the unknowns ``parts``, in their order; ``size`` is the number of all unknowns."""
    places = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    unit = np.zeros((size, len(places)))
    unit[places, np.arange(len(places))] = 1.0
    return factors.solve(unit)[places]
