"""Whether a table means what its columns say: the offsets read otherwise, and which reading the sightings prefer.

Readings are compared by the likelihood of the numbers in the table, not by what is left on the sky: an offset that was
already multiplied by cos E leaves less, because it is smaller. With the scale s of n sightings,

    log L = -2 n log s + sum log |d(sky) / d(offset)|

where the derivative is cos E for an azimuth offset as such and 1 for one that was multiplied already. Both offsets with
the wrong sign give all errors with the wrong sign and the same likelihood: that no sighting can tell.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from ship_geometry.rotations import FloatArray
from theodolite_calib.axis_fit.robust_fit import fit
from theodolite_calib.axis_fit.sightings import Sightings, directions

# Of the logarithms of the likelihoods: a reading is told when it is twenty thousand times as likely as the one given.
_TOLD = 10.0
# Nearer to the zenith than this nobody divides.
_LEAST_COSINE = 1e-3


def doubts(sightings: Sightings, fixed: Mapping[str, float]) -> list[str]:
    """What speaks against the table as it was read; as many sightings as errors to fit at least.

    Args:
        sightings: as read.
        fixed: errors that are not fitted, by name, with their values, rad.
    """
    # Errors that sightings share move all readings alike: they are counted by what they do to neighbours.
    alone = replace(sightings, slow_errors=())
    given, independent = _log_likelihood(alone, fixed)
    best, text = max((_gain(other, given, fixed), words) for other, words in _readings(alone))
    return [text] if independent * best > _TOLD else []


def _gain(reading: tuple[Sightings, float], given: float, fixed: Mapping[str, float]) -> float:
    sightings, by_derivative = reading
    likelihood, _ = _log_likelihood(sightings, fixed)
    return likelihood + by_derivative - given


def _log_likelihood(sightings: Sightings, fixed: Mapping[str, float]) -> tuple[float, float]:
    """Of the directions, and the share of the sightings that count as independent."""
    result = fit(sightings, fixed)
    share = min(1.0, max(0.0, (1.0 - result.neighbours) / (1.0 + result.neighbours)))
    return -2.0 * len(sightings.labels) * float(np.log(result.scale)), share


def _readings(sightings: Sightings) -> Iterator[tuple[tuple[Sightings, float], str]]:
    """Other readings with what they add to the likelihood, and the words that go with them."""
    azimuth, elevation = sightings.offsets()
    cosine = np.cos(sightings.elevation)
    cosine = np.where(np.abs(cosine) < _LEAST_COSINE, _LEAST_COSINE, cosine)
    yield (
        (_with_offsets(sightings, azimuth / cosine, elevation), -float(np.sum(np.log(np.abs(cosine))))),
        "azimuth_offset_deg looks as if it were already multiplied by cos E: expected true minus encoder as it is",
    )
    words = "looks as if it had the other sign than {} has: give true minus encoder in both"
    yield (
        (_with_offsets(sightings, -azimuth, elevation), 0.0),
        f"azimuth_offset_deg {words.format('elevation_offset_deg')}",
    )


def _with_offsets(sightings: Sightings, azimuth: FloatArray, elevation: FloatArray) -> Sightings:
    return replace(sightings, direction_d=directions(sightings.azimuth + azimuth, sightings.elevation + elevation))
