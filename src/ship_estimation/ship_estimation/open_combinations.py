"""Which combinations of states the data have left as open as they were before, in words.

A single state may look unknown although its sum with another one is known well: what is told is the combination. Each
one has as few states as possible.
"""

from collections.abc import Sequence

import numpy as np

from ship_geometry.rotations import FloatArray

_OPEN = 0.5
"""A combination with a larger share of the sigma from before left counts as open."""

_TAKES_PART = 0.1
"""States with a smaller share of the largest one, in sigmas from before, take no part in a combination."""


def open_combinations(
    covariance: FloatArray, sigma: FloatArray, leading: Sequence[str], told: Sequence[str] | None = None
) -> tuple[str, ...]:
    """Combinations of names that are open, as ``g - deformation_up``.

    Args:
        covariance: of n states, shape (n, n).
        sigma: of each before the data, more than 0, shape (n,).
        leading: names of the states. In this order they lead the combinations: the one that leads a combination is
            eliminated from all others, and the last ones pair with whatever is left.
        told: the same names in the order in which a combination tells them; None for the same order.

    Example:
        Only the sum of two was measured; the third was found:

        >>> covariance = np.array([[0.5, -0.5, 0.0], [-0.5, 0.5, 0.0], [0.0, 0.0, 0.01]])
        >>> open_combinations(covariance, np.ones(3), ["heading", "azimuth", "roll"])
        ('heading - azimuth',)
    """
    values, vectors = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    # Rows: open combinations, in sigmas from before.
    runs = _sparse(vectors[:, values > _OPEN**2].T)
    told = leading if told is None else told
    return tuple(_words(run, sigma, leading, told) for run in runs)


def _words(run: FloatArray, sigma: FloatArray, names: Sequence[str], told: Sequence[str]) -> str:
    """A combination in words: its states, with a factor where they are not as large as the first one.

    Args:
        run: the combination in sigmas from before, shape (n,).
        sigma: of each state before the data, shape (n,).
        names: of the states.
        told: the same names in the order in which they are told.
    """
    taking_part = np.flatnonzero(np.abs(run) > _TAKES_PART * np.max(np.abs(run)))
    part = sorted(taking_part.tolist(), key=lambda index: told.index(names[index]))
    sizes = (run * sigma)[part] / (run * sigma)[part[0]]
    words: str = names[part[0]]
    for index, size in zip(part[1:], sizes[1:], strict=True):
        factor = "" if abs(abs(size) - 1.0) < _TAKES_PART else f"{abs(size):.2g} "
        words += f" {'-' if size < 0.0 else '+'} {factor}{names[index]}"
    return words


def _sparse(runs: FloatArray) -> FloatArray:
    """Rows that span the same space, each with as few elements as possible: Gauss–Jordan, leading columns in order."""
    runs = runs.copy()
    done = 0
    for column in range(runs.shape[1]):
        if done == len(runs):
            break
        pivot = done + int(np.argmax(np.abs(runs[done:, column])))
        if abs(runs[pivot, column]) < _TAKES_PART * np.max(np.abs(runs[pivot])):
            continue
        runs[[done, pivot]] = runs[[pivot, done]]
        runs[done] /= runs[done, column]
        others = np.arange(len(runs)) != done
        runs[others] -= np.outer(runs[others, column], runs[done])
        done += 1
    return runs
