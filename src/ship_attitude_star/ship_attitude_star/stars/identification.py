"""Which star is it: detections without an identity, by the attitude that is predicted for their sensor.

The nearest catalogue star within the gate; where a second one could be meant too, none.
"""

from dataclasses import replace

import numpy as np

from ship_attitude_star.measurements.star_exposure import StarExposure
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.stars.selection import AttitudePrior, across, distance
from ship_estimation.gates import chi_square_gate
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, skew
from ship_geometry.star_directions import StarPositions

GATE_PROBABILITY = 0.9999
MAGNITUDE_TOLERANCE = 1.5
"""A star so much brighter or fainter than what was measured is not meant; colours and Hp against V make for most."""

_FIELD_MARGIN = np.deg2rad(1.0)
"""Aberration, refraction and the prediction's own error, together far less."""


def identified(
    exposure: StarExposure, prior: AttitudePrior, watch: SkyWatch
) -> tuple[StarExposure, dict[int, Refusal]]:
    """The exposure with identities for those stars that had none, where there is one.

    Args:
        exposure: at a moment that the watch's ``reason_against`` has nothing against.
        prior: attitude of the sensor.
        watch: the sky, its catalogue, and how faint a star may be.

    Returns:
        The exposure, and for each row that is still without an identity the reason.
    """
    rows = np.flatnonzero(~exposure.identified)
    candidates = _in_field(exposure.directions_s[rows], exposure.time_ns, prior, watch)
    catalogue = watch.catalogue
    apparent = watch.apparent(catalogue.at_j2000[candidates], exposure.time_ns)
    candidates, reference_n = candidates[apparent.visible], apparent.direction_n[apparent.visible]
    seen_n = exposure.directions_s[rows] @ prior.rotation_nb.T
    variance = exposure.sigma[rows, None] ** 2 + catalogue.position_sigma[candidates] ** 2
    smear_n = None if exposure.smear_s is None else prior.rotation_nb @ exposure.smear_s[rows] @ prior.rotation_nb.T
    close = _mahalanobis(seen_n, reference_n, variance, smear_n, prior) < chi_square_gate(GATE_PROBABILITY, 2)
    unlike = np.abs(exposure.magnitude[rows, None] - catalogue.magnitude[candidates]) > MAGNITUDE_TOLERANCE
    close &= ~unlike
    # A star that two detections claim is nobody's, and one that has its detection is no other's: none counts twice.
    claimed_once = (np.count_nonzero(close, axis=0) == 1) & ~np.isin(catalogue.hip[candidates], exposure.hip)
    chosen = np.full(len(rows), -1)
    reasons: dict[int, Refusal] = {}
    for number, row in enumerate(rows.tolist()):
        found = np.flatnonzero(close[number])
        if len(found) == 1 and claimed_once[found[0]]:
            chosen[number] = candidates[found[0]]
        else:
            reasons[row] = _why_not(seen_n[number], reference_n, len(found))
    taken = chosen >= 0
    return _filled(exposure, rows[taken], chosen[taken], watch), reasons


def _in_field(directions_s: FloatArray, time_ns: int, prior: AttitudePrior, watch: SkyWatch) -> np.ndarray:
    """Rows of the catalogue that may be in the field, those that the sensor can see."""
    place, _ = watch.surroundings(time_ns)
    rotation_nc = watch.sky.rotation_horizon_from_icrs(time_ns, place)
    centre_s = np.mean(directions_s, axis=0)
    centre_s /= np.linalg.norm(centre_s)
    radius = np.max(angle_between(directions_s, centre_s)) + _FIELD_MARGIN
    centre_c = rotation_nc.T @ prior.rotation_nb @ centre_s
    bright = watch.bright_rows
    return bright[watch.bright_directions @ centre_c > np.cos(radius)]


def _mahalanobis(
    seen_n: FloatArray, reference_n: FloatArray, variance: FloatArray, smear_n: FloatArray | None, prior: AttitudePrior
) -> FloatArray:
    """Distance² of each detection to each candidate under the prior's error, shape (k, c)."""
    basis = across(seen_n)
    left = np.einsum("kij,kcj->kci", basis, reference_n - seen_n[:, None, :])
    turned = basis @ skew(seen_n)
    covariance = turned @ prior.covariance_n @ np.swapaxes(turned, -1, -2)
    if smear_n is not None:
        covariance += basis @ smear_n @ np.swapaxes(basis, -1, -2)
    near = np.einsum("cj,kj->kc", reference_n, seen_n) > 0.0
    return np.where(near, distance(left, covariance[:, None] + variance[..., None, None] * np.eye(2)), np.inf)


def _why_not(seen_n: FloatArray, reference_n: FloatArray, found: int) -> Refusal:
    if found:
        return Refusal(Reason.UNIDENTIFIED, f"{found} catalogue stars within the gate, or one claimed twice: left out")
    if not len(reference_n):
        return Refusal(Reason.UNIDENTIFIED, "no catalogue star in the field")
    nearest = float(np.min(angle_between(reference_n, seen_n))) / ARCSEC
    return Refusal(Reason.UNIDENTIFIED, f'no catalogue star within the gate, the nearest is {nearest:.0f}" away')


def _filled(exposure: StarExposure, rows: np.ndarray, chosen: np.ndarray, watch: SkyWatch) -> StarExposure:
    """The exposure with catalogue stars in some of its rows."""
    catalogue = watch.catalogue
    hip, position_sigma = exposure.hip.copy(), exposure.position_sigma.copy()
    hip[rows] = catalogue.hip[chosen]
    position_sigma[rows] = catalogue.sigma(chosen, watch.year(exposure.time_ns))
    positions = {}
    for name in StarPositions.__dataclass_fields__:
        column = getattr(exposure.positions, name).copy()
        column[rows] = getattr(catalogue.at_j2000, name)[chosen]
        positions[name] = column
    return replace(exposure, hip=hip, positions=StarPositions(**positions), position_sigma=position_sigma)
