"""Least-squares fit of one attitude to stars, with the errors that the stars share as further unknowns.

:func:`fit_attitude` solves Wahba's problem (:mod:`ship_geometry.wahba`) and refines the solution. It is called for the
selection of stars and by :func:`ship_stars.attitude_from_stars.solution.solve_stars` for the selected ones. The
measurement of the filter of ``ship_attitude`` is not this attitude, but the residuals of the single stars
(:mod:`ship_stars.attitude_from_stars.residuals`).

The frame b is the frame in which the stars were measured: the deck, or the frame of one sensor. Star i has the measured
direction u_i (frame b) and the sky direction v_i (horizon frame n). At an attitude R (n from b) near the truth, the
displacement d_i of the star is linear in small unknowns:

    d_i = v_i - R u_i = δ × v_i + (R m_s) × v_i + (R T_s t) × v_i - R F_i f - G_i z + noise

- δ is the error of the attitude.
- m_s is the mounting error of the star's sensor s.
- t are the errors of the rotations that transfer the exposures to one time. The columns of T_s are the rotations of the
  sensor by one sigma of each of these errors; sensors may share these errors.
- f are the coefficients of the cameras' errors (:mod:`ship_stars.camera.errors`). The columns of F_i are the
  displacements of the measured direction by one sigma of each coefficient.
- z are the errors that all stars share (refraction, Earth rotation, position). The columns of G_i are the displacements
  of the sky direction by one sigma of each error.

The unknowns m, t, f and z are in units of their standard deviations, so that their prior information is the identity.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ship_estimation.innovations.gates import probability_above
from ship_geometry import wahba
from ship_geometry.rotations import FloatArray, exp_rotation
from ship_kernels import compiled_stars
from ship_kernels.compiled_innovations import square_root

ATTITUDE = slice(0, 3)
"""Columns of δ among the unknowns; mounting errors, time-transfer errors, field errors and shared errors follow."""

_NO_TURN, _NO_TURNS = np.zeros(3), np.empty((0, 3, 0))


@dataclass(frozen=True)
class MatchedStars:
    """The k identified stars of one time, with directions in one frame b, which is a sensor's frame or the deck frame.

    Attributes:
        measured_b: measured directions, unit vectors, shape (k, 3).
        reference_n: apparent directions of the stars with refraction, unit vectors in the horizon frame, shape (k, 3).
        sigma: standard deviation of each measured direction, rad per axis, shape (k,).
        position_sigma: standard deviation of each catalogue position, rad per axis, shape (k,).
        shared_n: displacement of the reference by one sigma of each shared error, rad, shape (k, 3, n_shared).
        sensor: index of the sensor that measured the star, shape (k,).
        mounting_b: rotation of each sensor by one sigma of three independent mounting errors; rotation vectors in b as
            columns, rad, shape (n_sensors, 3, 3). The shape is (0, 3, 3) if b is the sensor's frame.
        smear_b: covariance that the motion during the exposure adds to a measured direction, in b, rad², shape (k, 3,
            3); None without motion.
        time_transfer_b: rotation of each sensor by one sigma of c independent errors of the transfer of exposures to
            one time; rotation vectors in b as columns, rad, shape (n_sensors, 3, c). None without a transfer.
        false_match_density: number of possible false matches of each star per steradian, shape (k,); None if the
            identities are certain.
        pixel_sigma: standard deviation of the pixel-spatial error of each measured direction, rad per axis, shape (k,);
            None without such an error.
        field_b: displacement of the measured direction by one sigma of f correlated camera errors (optics,
            field-spatial), rad, shape (k, 3, f); None without such errors.
        field_sources: error source of each of the f camera errors.
    """

    measured_b: FloatArray
    reference_n: FloatArray
    sigma: FloatArray
    position_sigma: FloatArray
    shared_n: FloatArray
    sensor: NDArray[np.intp]
    mounting_b: FloatArray
    smear_b: FloatArray | None = None
    time_transfer_b: FloatArray | None = None
    false_match_density: FloatArray | None = None
    pixel_sigma: FloatArray | None = None
    field_b: FloatArray | None = None
    field_sources: tuple[str, ...] = ()

    @cached_property
    def white_sigma(self) -> FloatArray:
        """Standard deviation of the independent errors of centroid, catalogue and pixel, rad per axis, shape (k,)."""
        sigma = np.hypot(self.sigma, self.position_sigma)
        return sigma if self.pixel_sigma is None else np.hypot(sigma, self.pixel_sigma)

    @cached_property
    def single_star_sigma(self) -> FloatArray:
        """Standard deviation of each star's direction, correlated camera errors included, rad per axis, shape (k,)."""
        if self.field_b is None:
            return self.white_sigma
        sigma: FloatArray = np.sqrt(self.white_sigma**2 + 0.5 * np.sum(self.field_b**2, axis=(-2, -1)))
        return sigma

    @property
    def max_sigma(self) -> FloatArray:
        """Standard deviation of each star's direction with the variance of its streak on each axis, rad, shape (k,)."""
        if self.smear_b is None:
            return self.single_star_sigma
        sigma: FloatArray = np.sqrt(self.single_star_sigma**2 + np.trace(self.smear_b, axis1=-2, axis2=-1))
        return sigma

    def __len__(self) -> int:
        return len(self.sigma)


@dataclass(frozen=True)
class StarFit:
    """All stars linearised at one attitude.

    Attributes:
        jacobian: derivative of the displacements with respect to the q unknowns, divided by the star's sigma, shape
            (k, 3, q).
        displacement: v - R u, divided by the star's sigma, which is larger along a streak; shape (k, 3).
        residual_n: v - R u, rad, shape (k, 3).
        free_count: number of unknowns without a prior: 3 (δ), or 0 after :meth:`with_prior`.
    """

    jacobian: FloatArray
    displacement: FloatArray
    residual_n: FloatArray
    free_count: int = 3

    def with_prior(self, covariance_n: FloatArray, expected_n: FloatArray | None = None) -> "StarFit":
        """Return the fit with a prior of δ from an attitude predicted without these stars.

        Args:
            covariance_n: covariance of the prediction's error, rad², shape (3, 3); it may be singular.
            expected_n: predicted δ, rad, shape (3,); None if the stars are linearised at the prediction.
        """
        # With its prior, δ is in units of standard deviations like the other unknowns.
        turn_n = _NO_TURN if expected_n is None else expected_n
        jacobian, displacement = compiled_stars.apply_prior(
            self.jacobian, self.displacement, square_root(covariance_n), turn_n
        )
        return StarFit(jacobian, displacement, self.residual_n, free_count=0)

    def normal_equations(self, members: NDArray[np.bool_] | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the normal equations without priors: information, shape (q, q), and right side, shape (q,).

        Args:
            members: True for each star that is used, shape (k,); None to use all stars.
        """
        found: tuple[FloatArray, FloatArray] = compiled_stars.normal_equations(
            self.jacobian, self.displacement, self._member_mask(members)
        )
        return found

    def solve(self, members: NDArray[np.bool_] | None = None) -> "StarFitSolution":
        """Return the most likely unknowns, and the remaining chi².

        Args:
            members: True for each star that is used, shape (k,); None to use all stars.

        Raises:
            numpy.linalg.LinAlgError: the members do not determine the attitude.
        """
        information, constrained, solution, chi_square, count = compiled_stars.solve_normal_equations(
            self.jacobian, self.displacement, self._member_mask(members), self.free_count
        )
        return StarFitSolution(information, constrained, solution, chi_square, 2 * count - self.free_count)

    def _member_mask(self, members: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
        """Return the members in the type of the compiled loops; ``members`` None means all stars."""
        return np.ones(len(self.displacement), dtype=np.uint8) if members is None else members.view(np.uint8)

    def chi_square_reduction(self, solution: "StarFitSolution", members: NDArray[np.bool_]) -> FloatArray:
        """Return, for each member, the reduction of chi² if this member is left out, shape (n_members,).

        Each value is distributed as chi² with two degrees of freedom if all members are correctly identified.
        """
        jacobian = self.jacobian[members]
        residual = self.displacement[members] - jacobian @ solution.unknowns
        leverage = jacobian @ np.linalg.inv(solution.information_with_prior) @ np.swapaxes(jacobian, -1, -2)
        # The component along the line of sight adds nothing: its displacement is zero, and its leverage too.
        without_member = np.linalg.solve(np.eye(3) - leverage, residual[..., None])[..., 0]
        reduction: FloatArray = np.einsum("ki,ki->k", residual, without_member)
        return reduction


@dataclass(frozen=True)
class StarFitSolution:
    """Most likely values of the q unknowns from some stars, and the remaining chi².

    Attributes:
        information: information about all unknowns from the stars alone, shape (q, q).
        information_with_prior: information about all unknowns from stars and priors, shape (q, q).
        unknowns: most likely values of the unknowns, shape (q,).
        chi_square: sum of squares of the remaining displacements and of the unknowns with a prior, in sigmas.
        degrees: degrees of freedom of ``chi_square``.
    """

    information: FloatArray
    information_with_prior: FloatArray
    unknowns: FloatArray
    chi_square: float
    degrees: int

    @property
    def probability(self) -> float:
        """Probability of a chi² at least as large by chance; 1 without degrees of freedom, NaN if chi² is NaN."""
        if self.degrees <= 0 and math.isfinite(self.chi_square):
            return 1.0
        return probability_above(self.chi_square, max(self.degrees, 1))


def linearise_stars(stars: MatchedStars, rotation_nb: FloatArray) -> StarFit:
    """Return the stars linearised at an attitude (horizon from b), shape (3, 3), within a degree of the truth."""
    jacobian, displacement, residual_n = compiled_stars.linearise_stars(
        stars.measured_b,
        stars.reference_n,
        stars.white_sigma,
        stars.shared_n,
        stars.sensor,
        stars.mounting_b,
        _NO_TURNS if stars.time_transfer_b is None else stars.time_transfer_b,
        rotation_nb,
    )
    if stars.field_b is not None:
        by_field = -rotation_nb @ stars.field_b / stars.white_sigma[:, None, None]
        before_shared = jacobian.shape[-1] - stars.shared_n.shape[-1]
        jacobian = np.concatenate([jacobian[..., :before_shared], by_field, jacobian[..., before_shared:]], axis=-1)
    if stars.smear_b is not None:
        smear = rotation_nb @ (stars.smear_b / stars.white_sigma[:, None, None] ** 2) @ rotation_nb.T
        values, vectors = np.linalg.eigh(np.eye(3) + smear)
        whitened = vectors * (values[:, None, :] ** -0.5) @ np.swapaxes(vectors, -1, -2)
        jacobian, displacement = whitened @ jacobian, (whitened @ displacement[..., None])[..., 0]
    return StarFit(jacobian, displacement, residual_n)


@dataclass(frozen=True)
class AttitudeFit:
    """Attitude from some of the stars, with its fit.

    Attributes:
        rotation_nb: attitude (horizon from b), shape (3, 3): the solution of Wahba's problem, corrected if stars are
            streaks or cameras have field errors.
        white_covariance_n: covariance of the attitude due to independent errors and field errors, rad², shape (3, 3).
        fit: all stars, linearised at the attitude.
        solution: solution from the stars that gave the attitude.
        field_weight: weight that eliminates the cameras' field errors (:func:`_field_weight`), shape (q, f); None if
            stars are points and cameras have no field errors.
    """

    rotation_nb: FloatArray
    white_covariance_n: FloatArray
    fit: StarFit
    solution: StarFitSolution
    field_weight: FloatArray | None = None


def fit_attitude(stars: MatchedStars, members: NDArray[np.bool_] | None = None) -> AttitudeFit | None:
    """Return the attitude from the members; None if the members do not determine an attitude.

    ``members`` None means all stars.
    """
    sigma = stars.white_sigma if members is None else np.where(members, stars.white_sigma, np.inf)
    solution = wahba.solve(stars.reference_n, stars.measured_b, sigma)
    if not solution.solved:
        return None
    fit = linearise_stars(stars, solution.rotation_nd)
    if stars.smear_b is None and stars.field_b is None:
        return AttitudeFit(solution.rotation_nd, solution.covariance_n, fit, fit.solve(members))
    # Wahba's problem has one sigma per star, also along a streak, and no field errors. One Gauss-Newton step from the
    # solution of Wahba's problem gives the best attitude.
    information, right_side = fit.normal_equations(members)
    fields = field_columns(stars, len(information))
    weight = _field_weight(information, fields)
    information = information - weight @ information[fields]
    right_side = right_side - weight @ right_side[fields]
    covariance_n: FloatArray = np.asarray(np.linalg.inv(information[ATTITUDE, ATTITUDE]), dtype=float)
    rotation_nb = exp_rotation(covariance_n @ right_side[ATTITUDE]) @ solution.rotation_nd
    fit = linearise_stars(stars, rotation_nb)
    return AttitudeFit(rotation_nb, covariance_n, fit, fit.solve(members), weight)


def field_columns(stars: MatchedStars, unknowns: int) -> slice:
    """Return the columns of the cameras' field errors among the unknowns; the shared errors are the last columns."""
    end = unknowns - stars.shared_n.shape[-1]
    return slice(end - len(stars.field_sources), end)


def _field_weight(information: FloatArray, fields: slice) -> FloatArray:
    """Return the weights W, shape (q, f), that eliminate the field errors: information - W @ information[fields].

    Args:
        information: information about all unknowns from the stars, shape (q, q). Field errors have a prior sigma of 1.
        fields: columns of the field errors.
    """
    own = information[fields, fields]
    weight: FloatArray = np.linalg.solve(own + np.eye(len(own)), information[fields]).T
    return weight


def square_roots(covariance: FloatArray) -> FloatArray:
    """Return matrices L with L Lᵀ equal to the covariances, shape (..., n, n), which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    roots: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return roots
