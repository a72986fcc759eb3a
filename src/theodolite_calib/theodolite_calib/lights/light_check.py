"""Are these lights what they are taken for? By the angles between them, and by what is known of the telescope.

The angle between two lights does not depend on the attitude: it checks baselines, identification and scale. When the
two lights change names, the angle stays and the image turns by half a turn: only a prior attitude or a third light can
tell that. An error of the principal point N' shifts all lights alike, and no check here can find it.
"""

from dataclasses import dataclass
from enum import Enum
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from ship_estimation.gates import chi_square_gate, normalized_error_squared
from ship_geometry.rotations import FloatArray, angle_between, log_rotation
from theodolite_calib.lights.image import Camera, Image
from theodolite_calib.lights.line_of_sight import LinesOfSight, covariance_by_source
from theodolite_calib.lights.telescope_attitude import AttitudePrior, TelescopeAttitude, solve, total

_MOST_LIGHTS = 4
"""With more lights no exchanges are tried, for their number grows as the factorial."""


class Verdict(Enum):
    """What became of the lights' names."""

    CONSISTENT = "consistent"
    SWAPPED = "swapped"
    """The lights do not fit as named, and fit far better with names exchanged, in one way only."""
    CONFLICT = "conflict"
    """The angles fit under no exchange of names, or under several: a light is not where it is said to be."""
    PRIOR_CONFLICT = "prior_conflict"
    """The angles fit under some names, but under none of these the attitude agrees with the prior."""


@dataclass(frozen=True)
class LightCheck:
    """Verdict on the lights of one exposure.

    Attributes:
        verdict: as :class:`Verdict` explains.
        order: the point ``order[i]`` of the image is light i; as named unless SWAPPED.
        attitude: of the telescope, by the lights alone in that order.
        prior_chi2: of the difference between that attitude and the prior, 3 degrees of freedom; None without a prior.
    """

    verdict: Verdict
    order: tuple[int, ...]
    attitude: TelescopeAttitude
    prior_chi2: float | None


@dataclass(frozen=True)
class AngleResiduals:
    """Angles between lights on the detector minus those between their lines of sight.

    Attributes:
        pairs: indices of the lights, shape (P, 2).
        residual: rad, shape (..., P).
        sigma: rad, shape (..., P); the focal length's error is in it.
        chi2: (residual / sigma)², one degree of freedom each, shape (..., P).
    """

    pairs: NDArray[np.intp]
    residual: FloatArray
    sigma: FloatArray
    chi2: FloatArray


def angle_residuals(image: Image, camera: Camera, lines: LinesOfSight) -> AngleResiduals:
    """The angles between all pairs of N lights, with what they should be."""
    count = lines.direction_n.shape[-2]
    pairs = np.array(list(combinations(range(count), 2)))
    seen_t = camera.directions(image.point_m)
    residual = _angles(seen_t, pairs) - _angles(lines.direction_n, pairs)

    by_seen = _angle_gradients(seen_t, pairs)
    by_line = _angle_gradients(lines.direction_n, pairs)
    detection = camera.direction_covariance(image.point_m, image.sigma_m)
    if image.smear_m2 is not None:
        by_point = camera.direction_by_point(image.point_m)
        detection = detection + by_point @ image.smear_m2 @ np.swapaxes(by_point, -1, -2)
    variance = np.einsum("...pix,...ixy,...piy->...p", by_seen, detection, by_seen)
    of_focal_length = np.einsum("...pix,...ix->...p", by_seen, camera.direction_by_focal_length(image.point_m))
    variance += (of_focal_length * np.asarray(camera.focal_length_sigma_m, dtype=float)[..., None]) ** 2
    rows = by_line.reshape(*by_line.shape[:-2], 3 * count)
    line_covariance = total(covariance_by_source(lines.terms))
    variance += np.einsum("...pi,...ij,...pj->...p", rows, line_covariance, rows)
    return AngleResiduals(pairs, residual, np.sqrt(variance), residual**2 / variance)


def check_lights(
    image: Image, camera: Camera, lines: LinesOfSight, probability: float, prior: AttitudePrior | None = None
) -> LightCheck:
    """Verdict on the lights of one exposure, two or more.

    Args:
        image: lights on the detector, shape (N, 2).
        camera: geometry of the telescope.
        lines: where lights of the same names are seen, in the same order.
        probability: that right lights pass each of the two tests.
        prior: attitude known beforehand.
    """
    count = lines.direction_n.shape[-2]
    named = tuple(range(count))
    as_named = _trial(image, camera, lines, named, prior)
    if _fits(as_named, probability):
        return as_named.check(Verdict.CONSISTENT)
    exchanges = [order for order in permutations(range(count)) if order != named] if count <= _MOST_LIGHTS else []
    trials = [_trial(image, camera, lines, order, prior) for order in exchanges]
    fitting = [trial for trial in trials if _fits(trial, probability)]
    # To fit a little better is no proof: without a prior two lights fit both ways alike.
    if len(fitting) == 1 and as_named.chi2 > fitting[0].chi2 + chi_square_gate(probability, 3):
        return fitting[0].check(Verdict.SWAPPED)
    angles_fit = any(_angles_fit(trial.attitude, probability) for trial in [as_named, *trials])
    return as_named.check(Verdict.PRIOR_CONFLICT if angles_fit and not fitting else Verdict.CONFLICT)


@dataclass(frozen=True)
class _Trial:
    order: tuple[int, ...]
    attitude: TelescopeAttitude
    prior_chi2: float | None

    @property
    def chi2(self) -> float:
        """Of angles and prior; infinite where there is no solution."""
        chi2 = float(self.attitude.chi2) + (self.prior_chi2 or 0.0)
        return chi2 if np.isfinite(chi2) else np.inf

    def check(self, verdict: Verdict) -> LightCheck:
        return LightCheck(verdict, self.order, self.attitude, self.prior_chi2)


def _trial(
    image: Image, camera: Camera, lines: LinesOfSight, order: tuple[int, ...], prior: AttitudePrior | None
) -> _Trial:
    attitude = solve(image.chosen(order), camera, lines)
    if prior is None:
        return _Trial(order, attitude, None)
    departure = log_rotation(attitude.rotation_nt @ prior.rotation_nt.T)
    chi2 = float(normalized_error_squared(departure, attitude.covariance_n + prior.covariance_n))
    return _Trial(order, attitude, chi2)


def _angles_fit(attitude: TelescopeAttitude, probability: float) -> bool:
    # An attitude that is not solved has chi2 NaN, and fits nothing.
    return bool(attitude.chi2 <= chi_square_gate(probability, attitude.degrees))


def _fits(trial: _Trial, probability: float) -> bool:
    if not _angles_fit(trial.attitude, probability):
        return False
    return trial.prior_chi2 is None or trial.prior_chi2 <= chi_square_gate(probability, 3)


def _angles(direction: FloatArray, pairs: NDArray[np.intp]) -> FloatArray:
    return angle_between(direction[..., pairs[:, 0], :], direction[..., pairs[:, 1], :])


def _angle_gradients(direction: FloatArray, pairs: NDArray[np.intp]) -> FloatArray:
    """Change of each pair's angle with each direction, shape (..., P, N, 3)."""
    gradients = np.zeros((*direction.shape[:-2], len(pairs), *direction.shape[-2:]))
    for p, (i, j) in enumerate(pairs):
        first, second = direction[..., i, :], direction[..., j, :]
        cosine = np.sum(first * second, axis=-1, keepdims=True)
        sine = np.linalg.norm(np.cross(first, second), axis=-1, keepdims=True)
        # Along the arc, away from the other light. Lights in one place have no such direction.
        sine = np.where(sine > 0.0, sine, np.nan)
        gradients[..., p, i, :] = (first * cosine - second) / sine
        gradients[..., p, j, :] = (second * cosine - first) / sine
    return gradients
