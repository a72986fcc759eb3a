"""Linear combinations of states that the data have not determined much better than the prior.

A single state may look unknown although its sum with another state is well known. The combinations are therefore given,
each with as few states as possible.
"""

from collections.abc import Sequence

import numpy as np

from ship_geometry.rotations import FloatArray

_UNOBSERVED_RATIO = 0.5
"""Ratio of sigma to prior sigma above which a combination counts as unobservable."""

_TAKES_PART = 0.1
"""Least coefficient of a state in a combination, relative to the largest coefficient, in prior sigmas."""


def unobservable_combinations(
    covariance: FloatArray, sigma: FloatArray, leading: Sequence[str], order: Sequence[str] | None = None
) -> tuple[str, ...]:
    """Return the unobservable combinations as texts, for example ``g - deformation_up``.

    Args:
        covariance: covariance of n states, shape (n, n).
        sigma: prior sigma of each state, above 0, shape (n,).
        leading: names of the states in the order of ``covariance``, which is the pivot order. The leading state of a
            combination is eliminated from all other combinations.
        order: names of the states in the order in which a text lists them; None for the order of ``leading``.

    Example:
        Only the sum of two states was measured; the third state was determined:

        >>> covariance = np.array([[0.5, -0.5, 0.0], [-0.5, 0.5, 0.0], [0.0, 0.0, 0.01]])
        >>> unobservable_combinations(covariance, np.ones(3), ["heading", "azimuth", "roll"])
        ('heading - azimuth',)
    """
    values, vectors = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    # The rows are unobservable combinations, in prior sigmas.
    runs = _sparse_basis(vectors[:, values > _UNOBSERVED_RATIO**2].T)
    order = leading if order is None else order
    return tuple(_text(run, sigma, leading, order) for run in runs)


def _text(run: FloatArray, sigma: FloatArray, names: Sequence[str], order: Sequence[str]) -> str:
    """Return a combination as text, with a factor for each state whose coefficient differs in size from the first.

    Args:
        run: coefficients of the combination in prior sigmas, shape (n,).
        sigma: prior sigma of each state, shape (n,).
        names: names of the states.
        order: names of the states in the order of the text.
    """
    taking_part = np.flatnonzero(np.abs(run) > _TAKES_PART * np.max(np.abs(run)))
    part = sorted(taking_part.tolist(), key=lambda index: order.index(names[index]))
    sizes = (run * sigma)[part] / (run * sigma)[part[0]]
    words: str = names[part[0]]
    for index, size in zip(part[1:], sizes[1:], strict=True):
        factor = "" if abs(abs(size) - 1.0) < _TAKES_PART else f"{abs(size):.2g} "
        words += f" {'-' if size < 0.0 else '+'} {factor}{names[index]}"
    return words


def _sparse_basis(runs: FloatArray) -> FloatArray:
    """Return rows of the same space with few non-zero elements each, by Gauss–Jordan elimination in column order."""
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
