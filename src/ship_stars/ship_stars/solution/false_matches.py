"""Expected number of false matches: sets of stars that are consistent with a prior by chance.

A false detection, or a star with a wrong identity, fits the prior if a catalogue star happens to be in its gate. With n
detections, ρ catalogue stars of a matching magnitude per steradian, and gates of area a, this occurs n ρ a times on
average. n ρ is :attr:`MatchedStars.false_match_density`. A second star must fit both the prior and the first star, so
its gate is smaller; each further star has a still smaller gate. The expected number of false sets is the product over
the stars.
"""

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import chi_square_gate
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.rotations import FloatArray, skew
from ship_stars.solution.fit import MatchedStars

GATE_PROBABILITY = 0.9999
"""Probability that a correctly identified detection passes its gate."""

MAX_FALSE_MATCHES = 1e-3
"""Maximum expected number of false sets for a set of stars to be accepted."""

WRONG_IDENTITY_RATIO = 0.01
"""Assumed ratio of wrong identities in the messages of sensors; a wrong identity may be any other star."""


def has_few_false_matches(stars: MatchedStars, covariance_n: FloatArray) -> bool:
    """True if the expected number of false matches of every single star is at most :data:`MAX_FALSE_MATCHES`.

    A set of several stars has fewer false matches, so a larger set needs no further test. The result is also True if
    there are no stars, or if the stars have no false match densities.

    Args:
        stars: matched stars with their false match densities.
        covariance_n: covariance of the prior's error, rad², shape (3, 3).
    """
    if stars.false_match_density is None or not len(stars):
        return True
    variance = 0.5 * float(np.trace(covariance_n)) + float(np.max(stars.max_sigma)) ** 2
    return float(np.max(stars.false_match_density)) * gate_area(variance) <= MAX_FALSE_MATCHES


def expected_false_matches(
    stars: MatchedStars, members: NDArray[np.bool_], basis: FloatArray, covariance_n: FloatArray
) -> float:
    """Return an upper bound of the expected number of false sets with as many stars as the members.

    Args:
        stars: matched stars with their false match densities.
        members: True for the consistent stars, shape (k,).
        basis: two unit vectors perpendicular to each star's direction in the horizon frame, shape (k, 2, 3).
        covariance_n: covariance of the prior's error, rad², shape (3, 3).
    """
    assert stars.false_match_density is not None
    expected, remaining_covariance_n = 1.0, covariance_n
    for row in np.flatnonzero(members).tolist():
        turned = basis[row] @ skew(stars.reference_n[row])
        cross = turned @ remaining_covariance_n
        gate = cross @ turned.T + stars.max_sigma[row] ** 2 * np.eye(2)
        expected *= float(stars.false_match_density[row]) * gate_area(float(np.sqrt(np.linalg.det(gate))))
        # Each further star would decrease the expected number, so this upper bound suffices.
        if expected <= MAX_FALSE_MATCHES:
            break
        remaining_covariance_n = remaining_covariance_n - cross.T @ np.linalg.solve(gate, cross)
    return expected


def gate_area(variance: float) -> float:
    """Return the solid angle of a gate, at most 4π, steradian.

    Args:
        variance: square root of the determinant of the gate's covariance, rad².
    """
    return min(float(np.pi * chi_square_gate(GATE_PROBABILITY, 2)) * variance, 4.0 * float(np.pi))


def ambiguous_identity_rejection(expected: float) -> Rejection:
    """Return the rejection of stars whose expected number of false sets is too large."""
    text = f"ambiguous identity: {expected:.2g} false sets expected to fit the prediction, limit {MAX_FALSE_MATCHES:g}"
    return Rejection(Reason.UNIDENTIFIED, text)
