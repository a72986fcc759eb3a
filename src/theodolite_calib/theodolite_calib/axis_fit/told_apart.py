"""Which axis errors the sightings cannot tell apart, or hardly: named, with how far they may run together.

Belsley, Kuh, Welsch, "Regression Diagnostics" (1980), ch. 3: the columns of the design are scaled to unit length; a
singular value far below the largest (its condition index far above 1) is a combination of errors that hardly moves the
pointing of these sightings. Taking part in it are the errors that owe it most of their variance.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ship_geometry.rotations import FloatArray
from theodolite_calib.axis_fit.robust_fit import PRIOR_SIGMAS, AxisFit

POORLY_TOLD_APART = 10.0
"""From this condition index on a combination is named."""

CORRELATED = 0.9
"""From this size of the correlation on a pair is named."""

# Share of an error's variance from which on it takes part in a combination.
_TAKES_PART = 0.25
# Share of the longest run of an open combination from which on an error takes part in it.
_TAKES_PART_OPEN = 0.02
# What is known of a small error without sightings: a combination that may run further has no information.
_KNOWN_BEFORE = float(PRIOR_SIGMAS[-1])
_ROUNDING = 1e-15


@dataclass(frozen=True)
class Combination:
    """Errors that may run together, nearly unseen.

    Attributes:
        names: of the errors that take part.
        run: how far each runs for one sigma of the combination, with its sign, rad.
        effect: what this run changes in the pointing, RMS over the sightings, rad.
        condition_index: of the combination.
    """

    names: tuple[str, ...]
    run: tuple[float, ...]
    effect: float
    condition_index: float


@dataclass(frozen=True)
class Unobservable:
    """Errors of which the sightings leave combinations entirely open.

    Attributes:
        names: of the errors that take part.
        count: how many independent combinations of them are open.
    """

    names: tuple[str, ...]
    count: int


def condition_number(fit: AxisFit) -> float:
    """Largest condition index: of the design with columns of unit length."""
    indices, _ = _combinations(fit)
    return float(indices[-1])


def unobservable(fit: AxisFit) -> Unobservable | None:
    """What the sightings say nothing about; None where they say something about everything."""
    _, runs = _combinations(fit)
    sizes = np.abs(runs)
    is_open = np.max(sizes, axis=1) > _KNOWN_BEFORE
    # Others run along by second-order effects of the errors themselves.
    takes_part = np.any(sizes[is_open] > _TAKES_PART_OPEN * np.max(sizes[is_open], axis=1, keepdims=True), axis=0)
    names = tuple(name for name, taking_part in zip(fit.fitted, takes_part, strict=True) if taking_part)
    return Unobservable(names, int(np.sum(is_open))) if names else None


def poorly_told_apart(fit: AxisFit) -> list[Combination]:
    """Observable combinations by falling condition index, from :data:`POORLY_TOLD_APART` on."""
    indices, runs = _combinations(fit)
    shares = runs**2 / np.sum(runs**2, axis=0)
    effect = fit.scale / np.sqrt(len(fit.weights))
    found = []
    for index, run, share in zip(indices, runs, shares, strict=True):
        part = np.flatnonzero(share > _TAKES_PART)
        if index < POORLY_TOLD_APART or np.any(np.abs(run) > _KNOWN_BEFORE) or len(part) == 0:
            continue
        signed = run[part] * np.sign(run[part[0]])
        found.append(Combination(tuple(fit.fitted[i] for i in part), tuple(signed.tolist()), effect, float(index)))
    return found[::-1]


def correlated_pairs(fit: AxisFit) -> list[tuple[str, str, float]]:
    """Pairs of names with their correlation, by falling size, from :data:`CORRELATED` on."""
    correlation = fit.correlation
    pairs = [
        (fit.fitted[i], fit.fitted[j], float(correlation[i, j]))
        for i, j in combinations(range(len(fit.fitted)), 2)
        if abs(correlation[i, j]) >= CORRELATED
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def _combinations(fit: AxisFit) -> tuple[FloatArray, FloatArray]:
    """Condition indices, rising, shape (k,), and how far each error runs for one sigma of each combination, (k, k)."""
    design = (np.sqrt(fit.weights)[:, None, None] * fit.design).reshape(-1, len(fit.fitted))
    lengths = np.linalg.norm(design, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    _, singular, vectors = np.linalg.svd(design / lengths, full_matrices=False)
    singular = np.maximum(singular, _ROUNDING * singular[0])
    return singular[0] / singular, fit.scale * vectors / singular[:, None] / lengths
