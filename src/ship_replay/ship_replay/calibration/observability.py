"""Which combinations of the installation angles a session could tell, from the covariances before and after it.

What star sensors see against each other is free of the INS's errors. What they have together — one turn of all of them
on the deck — is seen only against an attitude of the deck: at constant heading the INS's error and a common error of
the installation look alike (models.md §4). So the joint error e = C t + r of all installations, C the turn of the deck
in the sensors' axes, is split in two parts that the prior P0 holds independent of each other:

    apart      r, with C^T P0^-1 r = 0, of 3 (N - 1) dimensions, in its principal directions
    together   t, as known once r is: (C^T P^-1 C)^-1

and each is compared with what was known of it beforehand: by the prior, and of t also by the errors of the INS as
configured, (C^T P0^-1 C + Sigma_ins^-1)^-1, which is what one look at constant heading gives.
"""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray

NOT_OBSERVED = 0.9
"""From this ratio of the sigmas, after / beforehand, on."""

WELL_OBSERVED = 0.5
"""Up to this ratio: three quarters of the variance are gone."""

DECK_AXES = ("bow", "up", "starboard")


@dataclass(frozen=True)
class Combination:
    """One way in which the installations may be wrong at the same time.

    Attributes:
        axis: of the deck, about which all sensors are turned together; None of sensors turned against each other.
        run_s: how far each sensor is turned for one sigma of it, rotation vector in its axes (forward, up, right), rad,
            shape (N, 3).
        sigma_before: known beforehand, rad.
        sigma: after the session, rad.
        shares: of the sources of error in its variance, shape (n_sources,).
    """

    axis: str | None
    run_s: FloatArray
    sigma_before: float
    sigma: float
    shares: FloatArray

    @property
    def ratio(self) -> float:
        """Sigma after / beforehand."""
        return self.sigma / self.sigma_before

    @property
    def observed(self) -> str:
        """yes, partly or no."""
        return verdict(self.ratio)


def verdict(ratio: float) -> str:
    """Whether a session that left this share of a sigma has observed the quantity: yes, partly or no."""
    if ratio >= NOT_OBSERVED:
        return "no"
    return "partly" if ratio > WELL_OBSERVED else "yes"


def combinations(
    prior_sigma: FloatArray, parts: FloatArray, rotations_ds: FloatArray, ins_sigma_d: FloatArray
) -> list[Combination]:
    """The three turns together, and what of the sensors against each other was not well observed, worst first.

    Args:
        prior_sigma: of each sensor's installation about its axes, rad, not zero, shape (N, 3).
        parts: joint covariance after the session by source of error, rad², shape (n_sources, 3 N, 3 N).
        rotations_ds: deck from sensor, shape (N, 3, 3).
        ins_sigma_d: error of the INS about the axes of the deck, rad, shape (3,).
    """
    scale = prior_sigma.ravel()
    whitened = parts / np.outer(scale, scale)
    turn = np.concatenate([rotation.T for rotation in rotations_ds])
    # All in prior sigmas: there the prior is the unit matrix, and independent means orthogonal.
    turned = turn / scale[:, None]
    information = np.linalg.solve(whitened.sum(axis=0), turned)
    to_together = np.linalg.solve(turned.T @ information, information.T)
    # An INS without errors about an axis is the deck itself: a look at it is an observation.
    has_errors = ins_sigma_d > 0.0
    ins_information = np.diag(np.divide(1.0, ins_sigma_d**2, out=np.zeros(3), where=has_errors))
    before = np.linalg.inv(turned.T @ turned + ins_information)
    found = []
    for number, axis in enumerate(DECK_AXES):
        variances = _variances(whitened, to_together[number])
        sigma = float(np.sqrt(variances.sum()))
        run_s = (sigma * turn[:, number]).reshape(-1, 3)
        shares = variances / variances.sum()
        found.append(Combination(axis, run_s, float(np.sqrt(before[number, number])), sigma, shares))
    across = np.linalg.qr(turned, mode="complete")[0][:, 3:]
    return found + _apart(whitened, scale, across)


def _apart(whitened: FloatArray, scale: FloatArray, basis: FloatArray) -> list[Combination]:
    """Directions of the sensors against each other that the session did not observe well."""
    _, vectors = np.linalg.eigh(basis.T @ whitened.sum(axis=0) @ basis)
    found = []
    for vector in (basis @ vectors[:, ::-1]).T:
        variances = _variances(whitened, vector)
        ratio = float(np.sqrt(variances.sum()))
        if ratio > WELL_OBSERVED:
            run = ratio * scale * vector * np.sign(vector[np.argmax(np.abs(scale * vector))])
            sigma = float(np.linalg.norm(run))
            found.append(Combination(None, run.reshape(-1, 3), sigma / ratio, sigma, variances / variances.sum()))
    return found


def _variances(parts: FloatArray, functional: FloatArray) -> FloatArray:
    """Variance of a linear combination by source of error, shape (n_sources,)."""
    return np.einsum("i,kij,j->k", functional, parts, functional)
