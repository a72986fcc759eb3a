"""Selection of correctly identified stars, by the attitude with which most of them are consistent.

A trial is a possible attitude, computed from a pair of stars whose measured angle fits the sky. If an attitude is
known beforehand (the prior), each trial is the prior corrected by a single star. All stars with
Mahalanobis² < 16 are members of the trial. While the probability of the members is below 1e-3, the worst member is
dropped. The last members (three without a prior, one with a prior) need only a probability above 1e-6. A trial is
accepted only if it has more members than any rival.
Without a prior at least three stars are needed to verify one another, because two stars with swapped identities are
always consistent.

A false detection, or a star with a wrong identity, fits the prior if a catalogue star happens to be in its gate. With n
detections, ρ catalogue stars of a matching magnitude per steradian, and gates of area a, this occurs n ρ a times on
average. n ρ is :attr:`MatchedStars.false_match_density`. A second star must fit both the prior and the first star, so
its gate is smaller; each further star has a still smaller gate. The expected number of false sets, which are consistent
by chance, is the product over the stars.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import chi_square_gate
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry import wahba
from ship_geometry.rotations import FloatArray, angle_between, left_jacobian, log_rotation, skew
from ship_stars.attitude_from_stars.attitude_fit import (
    AttitudeFit,
    MatchedStars,
    StarFit,
    StarFitSolution,
    fit_attitude,
    linearise_stars,
)

GATE_PROBABILITY = 0.9999
"""Probability that a correctly identified detection passes its gate."""

MAX_FALSE_MATCHES = 1e-3
"""Maximum expected number of false sets for a set of stars to be accepted."""

WRONG_IDENTITY_RATIO = 0.01
"""Assumed ratio of wrong identities in the messages of sensors; a wrong identity may be any other star."""


MEMBER_GATE = 16.0
"""Gate of a trial's members, Mahalanobis² (two degrees of freedom)."""

DROP_PROBABILITY, ACCEPT_PROBABILITY = 1e-3, 1e-6
"""Limits of the probability of the members' chi².

If the probability is below the first limit, the worst member is dropped, until the minimum number of members is left.
These last members are accepted if their probability is above the second limit.
"""

MIN_VERIFIED_STARS = 3
"""Minimum number of stars that verify one another without a prior."""

AMBIGUITY_THRESHOLD = 13.8
"""Threshold of the chi² difference between two explanations (two degrees of freedom, 1 in 1000)."""

LINEAR_RANGE = 5e-4
"""Maximum root of the summed variances of a predicted attitude for which one linearisation suffices, rad.

The neglected second-order term, half the square of the error, is 0.2″ for an error of three standard deviations.
"""

_MAX_REFINED_TRIALS = 3

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class StarPrior:
    """Attitude that is known without the stars of the exposure.

    Attributes:
        rotation_nb: attitude (horizon from b), shape (3, 3).
        covariance_n: error covariance of the attitude, rotation vector in the horizon frame, rad², shape (3, 3).
    """

    rotation_nb: FloatArray
    covariance_n: FloatArray

    @property
    def is_wide(self) -> bool:
        """True if the error may be too large for one linearisation."""
        return float(np.trace(self.covariance_n)) > LINEAR_RANGE**2

    def relative_to(self, rotation_nb: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the expected rotation vector from another attitude to the prior, and its covariance.

        Returns:
            Rotation vector in the horizon frame, rad, shape (3,).
            Covariance of the rotation vector, rad², shape (3, 3).
        """
        expected_n = log_rotation(self.rotation_nb @ rotation_nb.T)
        by_error = left_jacobian(-expected_n)
        covariance_n: FloatArray = by_error @ self.covariance_n @ by_error.T
        return expected_n, covariance_n


@dataclass(frozen=True)
class StarSelection:
    """The selected stars.

    Attributes:
        members: True for each selected star, shape (k,); all False if no set is consistent and larger than its rivals,
            or if too many sets of wrong stars are expected to fit the prior.
        attitude_fit: attitude from the selected stars; None if the selection did not compute it.
        false_matches: expected number of sets of wrong stars that fit the prior by chance if it exceeds
            MAX_FALSE_MATCHES; else None.
    """

    members: BoolArray
    attitude_fit: AttitudeFit | None = None
    false_matches: float | None = None


def select_stars(
    stars: MatchedStars, prior: StarPrior | None = None, initial_nb: FloatArray | None = None
) -> StarSelection:
    """Select the correctly identified stars.

    Args:
        stars: all measured stars that have a sky direction.
        prior: attitude used to select among sets and to accept a single star. The attitude of the selected stars does
            not depend on the prior.
        initial_nb: attitude within a degree of the truth, shape (3, 3); None if the prior is that near.
    """
    if prior is None:
        return _select_without_prior(stars)
    members = _select_with_prior(stars, prior, initial_nb)
    if stars.false_match_density is not None and members.any() and not has_few_false_matches(stars, prior.covariance_n):
        expected = expected_false_matches(stars, members, perpendicular_basis(stars.reference_n), prior.covariance_n)
        # Written so that NaN rejects the star.
        if not expected <= MAX_FALSE_MATCHES:
            return StarSelection(np.zeros_like(members), false_matches=expected)
    return StarSelection(members)


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


def _select_without_prior(stars: MatchedStars) -> StarSelection:
    everything = np.ones(len(stars), dtype=bool)
    if len(stars) < 2:
        return StarSelection(~everything)
    whole = fit_attitude(stars)
    if whole is not None and whole.solution.probability >= DROP_PROBABILITY:
        return StarSelection(everything, whole)
    trials = _pair_trials(stars)
    for trial in trials[:_MAX_REFINED_TRIALS]:
        members = _refine_without_prior(stars, trial)
        if members.any() and not _has_rival(trials, members, shared=2):
            refined = fit_attitude(stars, members)
            assert refined is not None
            return StarSelection(_drop_ambiguous(refined.fit, members))
    return StarSelection(~everything)


def _refine_without_prior(stars: MatchedStars, members: BoolArray) -> BoolArray:
    """Drop the members that do not fit the rest; drop all members if the rest is inconsistent too."""
    while np.count_nonzero(members) >= 2:
        refined = fit_attitude(stars, members)
        if refined is None:
            break
        if refined.solution.probability >= DROP_PROBABILITY:
            return members
        if np.count_nonzero(members) <= MIN_VERIFIED_STARS:
            return members if refined.solution.probability > ACCEPT_PROBABILITY else np.zeros_like(members)
        members = _drop_worst(refined.fit, refined.solution, members)
    return np.zeros_like(members)


def _drop_ambiguous(fit: StarFit, members: BoolArray) -> BoolArray:
    """Drop the ambiguous members.

    A member is ambiguous if a star outside the set could replace it: chi² of the set with the other star is larger by
    less than AMBIGUITY_THRESHOLD.
    """
    limit = fit.solve(members).chi_square + AMBIGUITY_THRESHOLD
    remaining: BoolArray = members.copy()
    for outsider in np.flatnonzero(~members):
        both = members.copy()
        both[outsider] = True
        solution = fit.solve(both)
        without_one = solution.chi_square - fit.chi_square_reduction(solution, both)
        # Written so that NaN rejects the star.
        remaining[np.flatnonzero(both)[~(without_one >= limit)]] = False
    return remaining


def _has_rival(trials: BoolArray, members: BoolArray, shared: int) -> bool:
    """True if a trial of another attitude has at least as many members.

    A trial that has ``shared`` or more stars in common with the members has their attitude, so it is not a rival.
    """
    large = trials[np.count_nonzero(trials, axis=-1) >= np.count_nonzero(members)]
    return bool(np.any(np.count_nonzero(large & members, axis=-1) < shared))


def _pair_trials(stars: MatchedStars) -> BoolArray:
    """Return the members of the trials of all pairs of stars whose measured angle fits the sky, shape (t, k).

    The trials are sorted by decreasing number of members.
    """
    first, second = np.triu_indices(len(stars), 1)
    seen = angle_between(stars.measured_b[first], stars.measured_b[second])
    expected = angle_between(stars.reference_n[first], stars.reference_n[second])
    common = _common_variance(stars)
    sigma = np.sqrt(stars.max_sigma**2 + common)
    fitting = np.abs(seen - expected) < np.sqrt(MEMBER_GATE) * np.hypot(sigma[first], sigma[second])
    pairs = np.stack([first[fitting], second[fitting]], axis=-1)
    solution = wahba.solve(stars.reference_n[pairs], stars.measured_b[pairs], sigma[pairs])
    pairs, solved = pairs[solution.solved], np.atleast_1d(solution.solved)
    rotation_nb, covariance_n = solution.rotation_nd[solved], solution.covariance_n[solved]
    basis = perpendicular_basis(stars.reference_n)
    displacement = stars.reference_n - stars.measured_b @ np.swapaxes(rotation_nb, -1, -2)
    residual = np.einsum("kij,tkj->tki", basis, displacement)
    turned = basis @ skew(stars.reference_n)
    covariance = np.einsum("kia,tab,kjb->tkij", turned, covariance_n, turned)
    own = (stars.single_star_sigma**2 + common)[:, None, None] * np.eye(2)
    if stars.smear_b is not None:
        turned_basis = basis @ rotation_nb[:, None]
        own = own + turned_basis @ stars.smear_b @ np.swapaxes(turned_basis, -1, -2)
    covariance += own
    members = mahalanobis_squared(residual, covariance) < MEMBER_GATE
    # A star in the opposite direction is not a member. The two stars of the trial are always members.
    members &= np.einsum("tkj,kj->tk", displacement, stars.reference_n) < 0.5
    members[np.arange(len(pairs))[:, None], pairs] = True
    return _sort_by_size(members, np.trace(covariance_n, axis1=-2, axis2=-1))


def _common_variance(stars: MatchedStars) -> FloatArray:
    """Return the variance that mounting, time transfer and shared errors add to each direction, rad², shape (k,).

    The variance is the mean over the two axes perpendicular to the direction.
    """
    variance: FloatArray = 0.5 * np.sum(stars.shared_n**2, axis=(-2, -1))
    if len(stars.mounting_b):
        about_star = skew(stars.measured_b)
        mounted = about_star @ stars.mounting_b[stars.sensor]
        variance = variance + 0.5 * np.sum(mounted**2, axis=(-2, -1))
    if stars.time_transfer_b is not None:
        turned = skew(stars.measured_b) @ stars.time_transfer_b[stars.sensor]
        variance = variance + 0.5 * np.sum(turned**2, axis=(-2, -1))
    return variance


def _select_with_prior(stars: MatchedStars, prior: StarPrior, initial_nb: FloatArray | None) -> BoolArray:
    everything = np.ones(len(stars), dtype=bool)
    if not everything.any():
        return everything
    if initial_nb is None:
        fit = linearise_stars(stars, prior.rotation_nb).with_prior(prior.covariance_n)
    else:
        expected_n, covariance_n = prior.relative_to(initial_nb)
        fit = linearise_stars(stars, initial_nb).with_prior(covariance_n, expected_n)
    if fit.solve(everything).probability >= DROP_PROBABILITY:
        return everything
    trials = _single_trials(stars, fit)
    for trial in trials[:_MAX_REFINED_TRIALS]:
        members = _refine_with_prior(fit, trial)
        if members.any() and not _has_rival(trials, members, shared=1):
            return _drop_ambiguous(fit, members)
    return ~everything


def _refine_with_prior(fit: StarFit, members: BoolArray) -> BoolArray:
    """Drop the members that do not fit the rest and the prior; drop all members if no member fits the prior."""
    while members.any():
        solution = fit.solve(members)
        if solution.probability >= DROP_PROBABILITY:
            return members
        if np.count_nonzero(members) == 1:
            return members if solution.probability > ACCEPT_PROBABILITY else np.zeros_like(members)
        members = _drop_worst(fit, solution, members)
    return members


def _drop_worst(fit: StarFit, solution: StarFitSolution, members: BoolArray) -> BoolArray:
    """Drop the member without which chi² decreases most."""
    remaining: BoolArray = members.copy()
    remaining[np.flatnonzero(members)[np.argmax(fit.chi_square_reduction(solution, members))]] = False
    return remaining


def _single_trials(stars: MatchedStars, fit: StarFit) -> BoolArray:
    """Return the members of the trials of single stars, shape (t, k), sorted by decreasing number of members.

    Each star corrects the prior; the other stars are compared with the corrected prior.
    """
    basis = perpendicular_basis(stars.reference_n)
    residual = np.einsum("kij,kj->ki", basis, fit.displacement)
    rows = basis @ fit.jacobian
    covariance = np.einsum("kia,lja->klij", rows, rows)
    own = np.arange(len(stars))
    covariance[own, own] += np.eye(2)
    possible = np.flatnonzero(mahalanobis_squared(residual, covariance[own, own]) < MEMBER_GATE)
    # Each possible star t corrects the prior; the other stars k are compared with the corrected prior.
    cross = covariance[:, possible].swapaxes(0, 1)
    gain = cross @ np.linalg.inv(covariance[possible, possible])[:, None]
    rest = residual - np.einsum("tkij,tj->tki", gain, residual[possible])
    rest_covariance = covariance[own, own] - gain @ np.swapaxes(cross, -1, -2)
    rest_covariance[np.arange(len(possible)), possible] = np.eye(2)
    rest[np.arange(len(possible)), possible] = 0.0
    members = mahalanobis_squared(rest, rest_covariance) < MEMBER_GATE
    return _sort_by_size(members, np.zeros(len(possible)))


def _sort_by_size(members: BoolArray, spread: FloatArray) -> BoolArray:
    """Sort trials by decreasing number of members, and trials of equal number by increasing spread of the attitude."""
    return members[np.lexsort((spread, -np.count_nonzero(members, axis=-1)))]


def mahalanobis_squared(residual: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return Mahalanobis² of residuals, shape (..., 2), under their covariances, shape (..., 2, 2)."""
    whitened = np.linalg.solve(covariance, residual[..., None])[..., 0]
    squared: FloatArray = np.einsum("...i,...i->...", residual, whitened)
    return squared


def perpendicular_basis(direction: FloatArray) -> FloatArray:
    """Return two unit vectors, shape (..., 2, 3), perpendicular to each direction, shape (..., 3), in any frame."""
    # The axis farthest from the direction defines the first vector, so that no direction is singular.
    axis = np.eye(3)[np.argmin(np.abs(direction), axis=-1)]
    first = np.cross(direction, axis)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=-2)
