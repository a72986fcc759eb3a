"""How many sets of stars would agree with a prior by chance: what the identity of a few stars is worth.

A detection that is no star, or that has the name of another star, fits the prior where a catalogue star happens to
stand in its gate. With n detections, each of which ρ catalogue stars per steradian may be by their magnitude, and gates
of the area a, that happens n ρ a times on the average (n ρ: :attr:`SightedStars.rivals`). A second star must fit the
prior and the first one, which leave it a smaller gate, and so on: the number of sets that agree by chance is the
product over the stars.
"""

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.stars.fit import SightedStars
from ship_estimation.gates import chi_square_gate
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.rotations import FloatArray, skew

GATE_PROBABILITY = 0.9999
"""A detection passes the gate of its star with this probability."""

MOST_BY_CHANCE = 1e-3
"""Of stars that agree with a prior no more sets than this, on the average, may do so by chance."""

WRONG_NAMES = 0.01
"""Share of the names given by sensors that is taken to be wrong. A star of a wrong name may be any other."""


def surely_few(stars: SightedStars, covariance_n: FloatArray) -> bool:
    """Whether even a single star fits a prior by chance less often than :data:`MOST_BY_CHANCE`, by a quick bound.

    Args:
        stars: with their rivals; those without any are told by others.
        covariance_n: of the prior's error, rad², shape (3, 3).
    """
    if stars.rivals is None or not len(stars):
        return True
    variance = 0.5 * float(np.trace(covariance_n)) + float(np.max(stars.worst_sigma)) ** 2
    return float(np.max(stars.rivals)) * gate_area(variance) <= MOST_BY_CHANCE


def by_chance(
    stars: SightedStars, members: NDArray[np.bool_], basis: FloatArray, covariance_n: FloatArray
) -> float:
    """How many sets of as many stars as the members are would agree with a prior by chance, on the average at most.

    Args:
        stars: with their rivals.
        members: the stars that agree, shape (k,).
        basis: two unit vectors across each star's direction in the horizon frame, shape (k, 2, 3).
        covariance_n: of the prior's error, rad², shape (3, 3).
    """
    assert stars.rivals is not None
    expected, left_n = 1.0, covariance_n
    for row in np.flatnonzero(members).tolist():
        turned = basis[row] @ skew(stars.reference_n[row])
        cross = turned @ left_n
        gate = cross @ turned.T + stars.worst_sigma[row] ** 2 * np.eye(2)
        expected *= float(stars.rivals[row]) * gate_area(float(np.sqrt(np.linalg.det(gate))))
        # That the first of them agree by chance is no less probable than that all do.
        if expected <= MOST_BY_CHANCE:
            break
        left_n = left_n - cross.T @ np.linalg.solve(gate, cross)
    return expected


def gate_area(variance: float) -> float:
    """Solid angle of a gate by the root of its covariance's determinant, at most all directions, steradian."""
    return min(float(np.pi * chi_square_gate(GATE_PROBABILITY, 2)) * variance, 4.0 * float(np.pi))


def improbable_identity(expected: float) -> Refusal:
    """The refusal of stars of which so many sets are expected to agree by chance."""
    text = f"they may be others: {expected:.2g} such sets agree with the prediction by chance, {MOST_BY_CHANCE:g} may"
    return Refusal(Reason.UNIDENTIFIED, text)
