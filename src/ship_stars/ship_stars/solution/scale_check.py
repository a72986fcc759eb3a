"""Check of a camera's focal length by the angles between the stars of an exposure; no attitude is needed.

If the focal length is wrong by far more than its sigma, the stars of a field are inconsistent: only few of them fit one
attitude. The field is then solved again with a nearly free focal length. If the stars are consistent with a focal
length far from the configured value, the whole exposure is rejected, because the few stars that fit would give a wrong
attitude.
"""

from dataclasses import replace

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection
from ship_stars.camera.optics_errors import OpticsErrors
from ship_stars.sky.sky_model import SkyModel
from ship_stars.solution.exposure import StarExposure, visible_stars
from ship_stars.solution.field_scale import estimate_optics, field_information
from ship_stars.solution.selection import MIN_VERIFIED_STARS, StarPrior, select_stars

FREE_FOCAL_SIGMA = 0.01
"""Relative standard deviation of a nearly free focal length."""

MAX_SIGMAS = 4.0
"""Threshold of the difference between fitted and configured focal length, standard deviations."""

_ENOUGH_STARS = 6
"""Minimum number of stars consistent with one attitude for which the focal length is not checked.

With a wrong focal length fewer stars would be consistent.
"""


def check_focal_length(
    exposure: StarExposure, sky_model: SkyModel, prior: StarPrior | None, used_count: int
) -> Rejection | None:
    """Return the rejection of an exposure whose stars contradict the focal length; None without a contradiction.

    The result is also None if the stars do not determine the focal length.

    Args:
        exposure: all detections.
        sky_model: the sky model.
        prior: attitude of the sensor known without these stars; None if no such attitude is known.
        used_count: number of detections that fit one attitude with the configured optics. The field is not solved again
            if all detections fit, or at least ``_ENOUGH_STARS``.
    """
    optics = exposure.optics
    if optics is None or used_count >= min(len(exposure), _ENOUGH_STARS) or len(exposure) < MIN_VERIFIED_STARS:
        return None
    free_sigma = max(FREE_FOCAL_SIGMA, optics.focal_sigma)
    visible = visible_stars(replace(exposure, optics=replace(optics, focal_sigma=free_sigma)), sky_model, prior)
    if isinstance(visible, Rejection):
        return None
    stars = visible[1]
    members = select_stars(stars, prior).members
    count = int(np.count_nonzero(members))
    if count < MIN_VERIFIED_STARS or count <= used_count:
        return None
    information = field_information(optics.camera, stars, members)
    principal = optics.principal_sigma_px
    found = None if information is None else estimate_optics(information, (np.inf, principal, principal))
    # Written so that NaN leads to the rejection.
    if found is None or abs(found.scale) <= MAX_SIGMAS * np.hypot(optics.focal_sigma, found.scale_sigma):
        return None
    return focal_length_rejection(optics, found.scale, f"the angles between {count} stars")


def check_estimated_focal_length(optics: OpticsErrors, error: float, variance: float) -> Rejection | None:
    """Return the rejection of an exposure if the filter's focal length is far from the configured one; else None.

    Args:
        optics: errors of the configured optics.
        error: estimate of the focal length's error, in sigmas.
        variance: variance of this estimate, in sigmas².
    """
    if abs(error) <= MAX_SIGMAS * np.sqrt(1.0 + variance):
        return None
    return focal_length_rejection(optics, error * optics.focal_sigma, "the stars up to now")


def focal_length_rejection(optics: OpticsErrors, scale: float, evidence: str) -> Rejection:
    """Return a rejection that states the fitted focal length.

    Args:
        optics: errors of the configured optics.
        scale: relative difference of the focal length, fitted minus configured.
        evidence: data to which the focal length is fitted, for the text.
    """
    configured_mm = 1e3 * optics.camera.focal_length_m
    text = (
        f"focal length {configured_mm * (1.0 + scale):.3f} mm fits {evidence}, configured {configured_mm:.3f} mm, "
        f"sigma {configured_mm * optics.focal_sigma:.3f} mm: check camera.focal_length_m"
    )
    return Rejection(Reason.MISIDENTIFIED, text)
