"""How well stars agree with one attitude, when the errors that they share may take any probable value.

The frame b is the frame in which the stars were measured: the deck, or the frame of one sensor. Star i was measured in
the direction u_i (frame b), and stands in the sky in the direction v_i (horizon frame n). At an attitude R_nb near the
truth its displacement d_i is linear in small unknowns:

    d_i = v_i - R u_i = δ × v_i + (R m_s) × v_i + (R T_s t) × v_i - R F_i f - G_i z + noise

δ is the error of the attitude, and m_s the mounting error of the star's sensor. t are the errors of the turns that
brought the exposures to one moment; T_s turns the sensor by one sigma of each, and sensors may share them. f are the
coefficients of the sensors' field-spatial errors (:mod:`ship_attitude_star.stars.spatial_errors`), and F_i displaces
the measured direction by one sigma of each. z are the errors that all stars share (refraction, Earth rotation,
position), and G_i is the displacement of the star by one sigma of each of them. The unknowns m, t, f and z are counted
in their standard deviations, so that their prior information is the identity.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.stars import compiled_fit
from ship_estimation.chi_square import probability_above
from ship_estimation.compiled_integrity import square_root
from ship_geometry import wahba
from ship_geometry.rotations import FloatArray, exp_rotation

ATTITUDE = slice(0, 3)
"""Columns of δ among the unknowns; those of mounting errors, of turns and of fields come next, shared errors last."""

_NO_TURN, _NO_TURNS = np.zeros(3), np.empty((0, 3, 0))


@dataclass(frozen=True)
class SightedStars:
    """Identified stars of one moment in one frame b: of one sensor in its own frame, or of several in the deck's.

    Attributes:
        measured_b: unit vectors, shape (k, 3).
        reference_n: where the stars stand in the sky, with refraction, unit vectors in the horizon frame, shape (k, 3).
        sigma: error of a measured direction, rad per axis, shape (k,).
        position_sigma: error of the catalogue's position, rad per axis, shape (k,).
        shared_n: displacement of the reference by one sigma of each shared error, rad, shape (k, 3, n_shared).
        sensor: index of the sensor that saw the star, shape (k,).
        mounting_b: turn of each sensor by one sigma of each of three independent errors of its mounting, rotation
            vectors in b as columns, rad, shape (n_sensors, 3, 3); (0, 3, 3) where b is the frame of the one sensor.
        smear_b: what the motion during the exposure adds to the error of a measured direction, covariance in b, rad²,
            shape (k, 3, 3); None where it adds nothing.
        turned_b: turn of each sensor by one sigma of each of c independent errors of the turns that brought the
            exposures to one moment, rotation vectors in b as columns, rad, shape (n_sensors, 3, c); None where there
            are none.
        rivals: how often per steradian a detection of the exposure and a star of the sky may be taken for this star by
            mistake, shape (k,); None where names are sure.
        pixel_sigma: pixel-spatial error of a measured direction, rad per axis, shape (k,); None where there is none.
        field_b: displacement of the measured direction by one sigma of each of f lasting errors of the cameras over
            their fields, optics and field-spatial, rad, shape (k, 3, f); None where there is no such error.
        field_sources: source of each of these errors.
    """

    measured_b: FloatArray
    reference_n: FloatArray
    sigma: FloatArray
    position_sigma: FloatArray
    shared_n: FloatArray
    sensor: NDArray[np.intp]
    mounting_b: FloatArray
    smear_b: FloatArray | None = None
    turned_b: FloatArray | None = None
    rivals: FloatArray | None = None
    pixel_sigma: FloatArray | None = None
    field_b: FloatArray | None = None
    field_sources: tuple[str, ...] = ()

    @cached_property
    def white_sigma(self) -> FloatArray:
        """Standard deviation of what differs from star to star, centroid and catalogue, rad per axis, shape (k,)."""
        sigma = np.hypot(self.sigma, self.position_sigma)
        return sigma if self.pixel_sigma is None else np.hypot(sigma, self.pixel_sigma)

    @cached_property
    def lone_sigma(self) -> FloatArray:
        """Standard deviation of a star taken by itself, what its sensor's field adds included, rad per axis, (k,)."""
        if self.field_b is None:
            return self.white_sigma
        sigma: FloatArray = np.sqrt(self.white_sigma**2 + 0.5 * np.sum(self.field_b**2, axis=(-2, -1)))
        return sigma

    @property
    def worst_sigma(self) -> FloatArray:
        """Upper bound of the standard deviation of the same in any direction, streaks included, rad, shape (k,)."""
        if self.smear_b is None:
            return self.lone_sigma
        sigma: FloatArray = np.sqrt(self.lone_sigma**2 + np.trace(self.smear_b, axis1=-2, axis2=-1))
        return sigma

    def __len__(self) -> int:
        return len(self.sigma)


@dataclass(frozen=True)
class StarFit:
    """All stars linearised at one attitude.

    Attributes:
        jacobian: derivative of the displacements by the q unknowns, divided by the star's sigma, shape (k, 3, q).
        displacement: v - R u, divided by the star's sigma, shape (k, 3); along a streak that sigma is larger.
        residual_n: v - R u, rad, shape (k, 3).
        open: number of unknowns without any prior: 3 (δ), or 0 after :meth:`with_prior`.
    """

    jacobian: FloatArray
    displacement: FloatArray
    residual_n: FloatArray
    open: int = 3

    def with_prior(self, covariance_n: FloatArray, expected_n: FloatArray | None = None) -> "StarFit":
        """The same fit where the attitude was predicted without these stars.

        Args:
            covariance_n: of the prediction's error δ, rad², shape (3, 3); singular where a turn is known exactly.
            expected_n: the δ that was predicted, rad, shape (3,), where the stars are linearised elsewhere than at the
                prediction; None where there.
        """
        # δ is then counted in standard deviations, as the other unknowns are.
        turn_n = _NO_TURN if expected_n is None else expected_n
        jacobian, displacement = compiled_fit.predicted(
            self.jacobian, self.displacement, square_root(covariance_n), turn_n
        )
        return StarFit(jacobian, displacement, self.residual_n, open=0)

    def normal_equations(self, members: NDArray[np.bool_] | None = None) -> tuple[FloatArray, FloatArray]:
        """What the members (all stars where none are named) say of the unknowns, without priors.

        Returns:
            Information, shape (q, q), and right side, shape (q,).
        """
        found: tuple[FloatArray, FloatArray] = compiled_fit.normal_equations(
            self.jacobian, self.displacement, self._chosen(members)
        )
        return found

    def judge(self, members: NDArray[np.bool_] | None = None) -> "StarJudgement":
        """The most likely unknowns by the members (all stars where none are named), and what they leave over.

        Raises:
            numpy.linalg.LinAlgError: the members leave the attitude open.
        """
        information, constrained, solution, chi_square, count = compiled_fit.judged(
            self.jacobian, self.displacement, self._chosen(members), self.open
        )
        return StarJudgement(information, constrained, solution, chi_square, 2 * count - self.open)

    def _chosen(self, members: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
        """The members as the compiled loops take them; all stars where none are named."""
        return np.ones(len(self.displacement), dtype=np.uint8) if members is None else members.view(np.uint8)

    def gain_by_leaving_out(self, judgement: "StarJudgement", members: NDArray[np.bool_]) -> FloatArray:
        """By how much chi² falls when one of the members is left out, for each of them, shape (n_members,).

        Each value is distributed as chi² with two degrees of freedom where all members are what they are taken for.
        """
        jacobian = self.jacobian[members]
        left = self.displacement[members] - jacobian @ judgement.solution
        leverage = jacobian @ np.linalg.inv(judgement.constrained) @ np.swapaxes(jacobian, -1, -2)
        # Along the line of sight there is no displacement. There the matrix is the identity and adds nothing.
        gain: FloatArray = np.einsum("ki,ki->k", left, np.linalg.solve(np.eye(3) - leverage, left[..., None])[..., 0])
        return gain


@dataclass(frozen=True)
class StarJudgement:
    """The most likely unknowns of some stars, and what they leave over.

    Attributes:
        information: of all unknowns by the stars alone, shape (q, q).
        constrained: the same with the priors, shape (q, q).
        solution: most likely values of the unknowns, shape (q,).
        chi_square: squares of the displacements that the solution leaves over, and of the solution against its priors.
        degrees: degrees of freedom of ``chi_square``.
    """

    information: FloatArray
    constrained: FloatArray
    solution: FloatArray
    chi_square: float
    degrees: int

    @property
    def probability(self) -> float:
        """Probability of a chi² at least as large by chance; 1 without degrees of freedom, NaN where chi² is NaN."""
        if self.degrees <= 0 and math.isfinite(self.chi_square):
            return 1.0
        return probability_above(self.chi_square, max(self.degrees, 1))


def linearized(stars: SightedStars, rotation_nb: FloatArray) -> StarFit:
    """The stars linearised at an attitude (horizon from b), shape (3, 3), within a degree of the truth."""
    jacobian, displacement, residual_n = compiled_fit.linearized(
        stars.measured_b,
        stars.reference_n,
        stars.white_sigma,
        stars.shared_n,
        stars.sensor,
        stars.mounting_b,
        _NO_TURNS if stars.turned_b is None else stars.turned_b,
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
class Agreement:
    """The attitude that some of the stars give, and how well they agree with it.

    Attributes:
        rotation_nb: horizon from b, shape (3, 3): the solution of Wahba's problem, corrected where stars are streaks
            or cameras have errors over their fields.
        white_covariance_n: of its error by what differs from star to star, and by the errors over the fields, rad²,
            shape (3, 3).
        fit: all stars, linearised at that attitude.
        judgement: of the stars that gave the attitude.
        field_weight: what eliminates the cameras' errors over their fields (:func:`_field_weight`), shape (q, f);
            None where stars are points and cameras have none.
    """

    rotation_nb: FloatArray
    white_covariance_n: FloatArray
    fit: StarFit
    judgement: StarJudgement
    field_weight: FloatArray | None = None


def agreement(stars: SightedStars, members: NDArray[np.bool_] | None = None) -> Agreement | None:
    """The attitude by the members, all stars where none are named; None where they leave the attitude open."""
    sigma = stars.white_sigma if members is None else np.where(members, stars.white_sigma, np.inf)
    solution = wahba.solve(stars.reference_n, stars.measured_b, sigma)
    if not solution.solved:
        return None
    fit = linearized(stars, solution.rotation_nd)
    if stars.smear_b is None and stars.field_b is None:
        return Agreement(solution.rotation_nd, solution.covariance_n, fit, fit.judge(members))
    # Wahba's problem has one sigma a star, also along a streak, and no error that stars share over a field. From its
    # solution one step leads to the best attitude.
    information, right_side = fit.normal_equations(members)
    fields = field_columns(stars, len(information))
    weight = _field_weight(information, fields)
    information = information - weight @ information[fields]
    right_side = right_side - weight @ right_side[fields]
    covariance_n: FloatArray = np.asarray(np.linalg.inv(information[ATTITUDE, ATTITUDE]), dtype=float)
    rotation_nb = exp_rotation(covariance_n @ right_side[ATTITUDE]) @ solution.rotation_nd
    fit = linearized(stars, rotation_nb)
    return Agreement(rotation_nb, covariance_n, fit, fit.judge(members), weight)


def field_columns(stars: SightedStars, unknowns: int) -> slice:
    """Columns of the cameras' errors over their fields among the unknowns; the shared errors are behind them."""
    end = unknowns - stars.shared_n.shape[-1]
    return slice(end - len(stars.field_sources), end)


def _field_weight(information: FloatArray, fields: slice) -> FloatArray:
    """Share of each unknown in the errors over the fields: what is subtracted to eliminate them, shape (q, f).

    Args:
        information: of all unknowns by the stars, shape (q, q). The errors have the prior sigma 1.
        fields: their columns.
    """
    own = information[fields, fields]
    weight: FloatArray = np.linalg.solve(own + np.eye(len(own)), information[fields]).T
    return weight


def square_roots(covariance: FloatArray) -> FloatArray:
    """Matrices L with L Lᵀ the covariances, shape (..., n, n), which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    roots: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return roots
