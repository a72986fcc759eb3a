"""How well stars agree with one attitude once all that they share is allowed for.

At an attitude R_nb the displacement of star i is linear in small unknowns (models.md §2, §3):

    d_i = v_i - R u_i = δ × v_i + (R m_s) × v_i - G_i z + noise

with δ the error of the attitude, m_s the mounting error of the star's sensor, z the errors that all stars share
(refraction, Earth rotation, position) and G_i what one sigma of each does. m and z are written as numbers of standard
deviation 1, so their prior information is the identity.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.special import chdtrc

from ship_geometry import wahba
from ship_geometry.rotations import FloatArray, exp_rotation, skew


@dataclass(frozen=True)
class SightedStars:
    """Identified stars of one moment, of one sensor or of several, in one frame b: the deck, or the sensor's own.

    Attributes:
        measured_b: unit vectors, shape (k, 3).
        reference_n: where the stars are seen, refraction included, unit vectors in the horizon frame, shape (k, 3).
        sigma: error of a measured direction, rad per axis, shape (k,).
        position_sigma: error of the catalogue's position, rad per axis, shape (k,).
        shared_n: displacement of the reference by one sigma of each shared error, rad, shape (k, 3, n_shared).
        sensor: which sensor saw it, shape (k,).
        mounting_b: turn of each sensor by one sigma of each of three independent errors of its mounting, rotation
            vectors in b as columns, rad, shape (n_sensors, 3, 3); (0, 3, 3) where b is the frame of the one sensor.
        smear_b: what the motion during the exposure adds to the error of a measured direction, covariance in b, rad²,
            shape (k, 3, 3); None where it adds nothing.
    """

    measured_b: FloatArray
    reference_n: FloatArray
    sigma: FloatArray
    position_sigma: FloatArray
    shared_n: FloatArray
    sensor: NDArray[np.intp]
    mounting_b: FloatArray
    smear_b: FloatArray | None = None

    @cached_property
    def white_sigma(self) -> FloatArray:
        """What differs from star to star: centroid and catalogue, rad per axis, shape (k,)."""
        return np.hypot(self.sigma, self.position_sigma)

    @property
    def worst_sigma(self) -> FloatArray:
        """The same along the streak, where there is one, rad, shape (k,)."""
        if self.smear_b is None:
            return self.white_sigma
        return np.sqrt(self.white_sigma**2 + np.trace(self.smear_b, axis1=-2, axis2=-1))

    def __len__(self) -> int:
        return len(self.sigma)


@dataclass(frozen=True)
class StarFit:
    """All stars linearised at one attitude.

    Attributes:
        jacobian: of the displacements, each divided by its sigma, shape (k, 3, q); the first three columns are δ.
        displacement: v - R u, divided by the sigma, shape (k, 3); of a streak, by another sigma along than across.
        residual_n: v - R u, rad, shape (k, 3).
        open: how many of the unknowns nothing is known of beforehand: the first three, δ, or none.
    """

    jacobian: FloatArray
    displacement: FloatArray
    residual_n: FloatArray
    open: int = 3

    def with_prior(self, covariance_n: FloatArray) -> "StarFit":
        """The same where the attitude was predicted without these stars.

        Args:
            covariance_n: of the prediction's δ, rad², shape (3, 3); singular where it is sure of something.
        """
        jacobian = self.jacobian.copy()
        # δ too is then written as numbers of standard deviation 1.
        jacobian[:, :, :3] = jacobian[:, :, :3] @ square_roots(covariance_n)
        return StarFit(jacobian, self.displacement, self.residual_n, open=0)

    def normal_equations(self, members: NDArray[np.bool_] | None = None) -> tuple[FloatArray, FloatArray]:
        """Information of the members without priors, (q, q), and its right side, (q,)."""
        jacobian, displacement = self.jacobian, self.displacement
        if members is not None:
            jacobian, displacement = jacobian[members], displacement[members]
        rows = jacobian.reshape(-1, jacobian.shape[-1])
        return rows.T @ rows, displacement.ravel() @ rows

    def judge(self, members: NDArray[np.bool_] | None = None) -> "StarJudgement":
        """Could these stars, all or the members, be seen like this?"""
        information, right_side = self.normal_equations(members)
        displacement = self.displacement if members is None else self.displacement[members]
        constrained = information.copy()
        known = np.arange(self.open, len(right_side))
        constrained[known, known] += 1.0
        degrees = 2 * len(displacement) - self.open
        _, solution, failed = lapack.dposv(constrained, right_side)
        if failed:
            raise np.linalg.LinAlgError("stars that leave the attitude open cannot be judged")
        flat = displacement.ravel()
        chi_square = float(flat @ flat - right_side @ solution)
        return StarJudgement(information, constrained, solution, chi_square, degrees)

    def gain_by_leaving_out(self, judgement: "StarJudgement", members: NDArray[np.bool_]) -> FloatArray:
        """By how much chi² falls without each of the members (chi² with two degrees of freedom), shape (n_members,)."""
        jacobian = self.jacobian[members]
        left = self.displacement[members] - jacobian @ judgement.solution
        leverage = jacobian @ np.linalg.inv(judgement.constrained) @ np.swapaxes(jacobian, -1, -2)
        # Along the line of sight there is no displacement: there the matrix is the identity and adds nothing.
        return np.einsum("ki,ki->k", left, np.linalg.solve(np.eye(3) - leverage, left[..., None])[..., 0])


@dataclass(frozen=True)
class StarJudgement:
    """What the best values of all unknowns leave over.

    Attributes:
        information: of all unknowns by the stars alone, shape (q, q).
        constrained: the same with the priors.
        solution: most likely values of the unknowns, shape (q,).
        chi_square: what is left.
        degrees: of freedom of it.
    """

    information: FloatArray
    constrained: FloatArray
    solution: FloatArray
    chi_square: float
    degrees: int

    @property
    def probability(self) -> float:
        """Of a chi² as large by chance; 1 where nothing is left to disagree, NaN where chi² is."""
        if self.degrees <= 0 and np.isfinite(self.chi_square):
            return 1.0
        return float(chdtrc(max(self.degrees, 1), np.maximum(self.chi_square, 0.0)))


def linearized(stars: SightedStars, rotation_nb: FloatArray) -> StarFit:
    """The stars at an attitude, shape (3, 3), no farther from the truth than a degree."""
    count, sensors, shared = len(stars), len(stars.mounting_b), stars.shared_n.shape[-1]
    per_sigma = 1.0 / stars.white_sigma[:, None]
    # δ × v per sigma, column by column of δ.
    about_star = -skew(stars.reference_n * per_sigma)
    jacobian = np.zeros((count, 3, 3 + 3 * sensors + shared))
    jacobian[:, :, :3] = about_star
    if sensors:
        mounting_n = rotation_nb @ stars.mounting_b
        turned = about_star @ mounting_n[stars.sensor]
        own = stars.sensor[:, None] == np.arange(sensors)
        blocks = jacobian[:, :, 3 : 3 + 3 * sensors].reshape(count, 3, sensors, 3)
        np.multiply(turned[:, :, None, :], own[:, None, :, None], out=blocks)
    np.multiply(stars.shared_n, -per_sigma[..., None], out=jacobian[:, :, 3 + 3 * sensors :])
    residual_n = stars.reference_n - stars.measured_b @ rotation_nb.T
    displacement = residual_n * per_sigma
    if stars.smear_b is not None:
        smear = rotation_nb @ (stars.smear_b * per_sigma[..., None] ** 2) @ rotation_nb.T
        values, vectors = np.linalg.eigh(np.eye(3) + smear)
        whitened = vectors * (values[:, None, :] ** -0.5) @ np.swapaxes(vectors, -1, -2)
        jacobian, displacement = whitened @ jacobian, (whitened @ displacement[..., None])[..., 0]
    return StarFit(jacobian, displacement, residual_n)


@dataclass(frozen=True)
class Agreement:
    """The attitude that some of the stars give, and how well they agree with it.

    Attributes:
        rotation_nb: horizon from b, by Wahba's problem, shape (3, 3); most likely where stars are streaks, too.
        white_covariance_n: of its error by what differs from star to star, rad², shape (3, 3).
        fit: all stars, linearised there.
        judgement: of the stars that gave it.
    """

    rotation_nb: FloatArray
    white_covariance_n: FloatArray
    fit: StarFit
    judgement: StarJudgement


def agreement(stars: SightedStars, members: NDArray[np.bool_] | None = None) -> Agreement | None:
    """What the members say, all stars where none are named; None where they leave the attitude open."""
    sigma = stars.white_sigma if members is None else np.where(members, stars.white_sigma, np.inf)
    solution = wahba.solve(stars.reference_n, stars.measured_b, sigma)
    if not solution.solved:
        return None
    fit = linearized(stars, solution.rotation_nd)
    if stars.smear_b is None:
        return Agreement(solution.rotation_nd, solution.covariance_n, fit, fit.judge(members))
    # Wahba's problem knows one sigma for each star. From its solution one step leads to the best attitude.
    information, right_side = fit.normal_equations(members)
    covariance_n: FloatArray = np.asarray(np.linalg.inv(information[:3, :3]), dtype=float)
    rotation_nb = exp_rotation(covariance_n @ right_side[:3]) @ solution.rotation_nd
    fit = linearized(stars, rotation_nb)
    return Agreement(rotation_nb, covariance_n, fit, fit.judge(members))


def square_roots(covariance: FloatArray) -> FloatArray:
    """Matrices L with L Lᵀ the covariances, shape (..., 3, 3), which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
