"""Errors that several sightings share: what a table states of them, as one linear map of independent unit errors.

A slow error is a Gauss-Markov process of the moment, or a constant where its correlation time is infinite. Each of its
values moves a sighting by the stated effect, so that two sightings are correlated by

    sum over the errors of  effect_i effect_jᵀ exp(-|t_i - t_j| / T)

The map is a root of that covariance: the fit then has these errors as further unknowns, each known to 1 beforehand.
"""

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from ship_geometry.rotations import ARCSEC, FloatArray

MOST_SIGHTINGS = 1000
"""With errors that fade in time: their covariance is taken apart as a whole."""

# What moves the sightings by less than this in all (rad, RMS) is left out of the map: it looks like their own error.
_LEAST_EFFECT = 0.1 * ARCSEC


@dataclass(frozen=True)
class SharedError:
    """One error that lasts over several sightings.

    Attributes:
        name: of the error.
        time_s: correlation time; infinite for a constant.
        effect: what one sigma of it moves each sighting by, to the right and up, shape (n, 2), rad.
    """

    name: str
    time_s: float
    effect: FloatArray


def slow_map(errors: tuple[SharedError, ...], time_s: FloatArray | None, count: int) -> FloatArray:
    """What independent errors of variance 1 move the sightings by, shape (count, 2, q), rad.

    Args:
        errors: as stated.
        time_s: moments of the sightings, shape (count,); needed only where an error fades.
        count: of the sightings.
    """
    columns = [error.effect.reshape(2 * count, 1) for error in errors if np.isinf(error.time_s)]
    fading = sorted((error for error in errors if not np.isinf(error.time_s)), key=lambda error: error.time_s)
    if fading:
        assert time_s is not None
        columns.append(_root(_covariance(fading, time_s)))
    return np.hstack([np.zeros((2 * count, 0)), *columns]).reshape(count, 2, -1)


def _covariance(fading: list[SharedError], time_s: FloatArray) -> FloatArray:
    """Of the sightings, right and up in turn, shape (2 n, 2 n), rad²."""
    apart_s = np.abs(np.subtract.outer(time_s, time_s))
    covariance = np.zeros((2 * len(time_s), 2 * len(time_s)))
    for correlation_s, errors in groupby(fading, key=lambda error: error.time_s):
        effects = np.stack([error.effect.ravel() for error in errors], axis=-1)
        # A correlation time of zero is white: each moment has its own error.
        kept = np.exp(-apart_s / correlation_s) if correlation_s > 0.0 else (apart_s == 0.0).astype(float)
        covariance += (effects @ effects.T) * np.repeat(np.repeat(kept, 2, axis=0), 2, axis=1)
    return covariance


def _root(covariance: FloatArray) -> FloatArray:
    """Columns whose products sum to the covariance but for what nobody could see."""
    values, vectors = np.linalg.eigh(covariance)
    # In rising order: the least ones together are below what counts.
    seen = np.cumsum(np.maximum(values, 0.0)) > _LEAST_EFFECT**2 * len(values)
    root: FloatArray = vectors[:, seen] * np.sqrt(values[seen])
    return root
