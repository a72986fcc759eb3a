"""Exposures of a camera in a bag: identified stars, and the focal length that fits the angles between them.

Stars without a catalogue number are identified with the predicted attitude of the camera. Their magnitudes are not
used, because the magnitudes may be wrong.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ship_estimation.rejection_rules import Rejection
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between
from ship_node.messages.field_checks import MessageRejected
from ship_stars.camera.config import CameraConfig
from ship_stars.messages.star_messages import ExposingSensor, star_exposure
from ship_stars.sky.sky_model import SkyModel
from ship_stars.solution.exposure import StarExposure, identify_stars
from ship_stars.solution.selection import StarPrior

_FEWEST_PAIRS = 5
_LEAST_PAIR_ANGLE = np.deg2rad(0.2)
_FIRST_FACTORS = 1.0, 0.1, 10.0
_SEARCH_STEPS, _SETTLED = 8, 1e-4

_PRIOR_SIGMA = 60.0 * ARCSEC
"""Sigma added to the predicted attitude about each axis, rad: displacement of a star 3° off axis if the focal length is
wrong by 0.5 %."""


class ImageAxes(NamedTuple):
    """Directions of the axes u and v in a camera's image.

    Attributes:
        text: difference to the expected directions, for people; empty if there is no difference.
        expected_s: matrix from measured to expected directions (forward, up, right), shape (3, 3).
    """

    text: str
    expected_s: FloatArray


EXPECTED_AXES = ImageAxes("", np.eye(3))

MIRRORED = (
    ImageAxes("u counts to the left", np.diag([1.0, 1.0, -1.0])),
    ImageAxes("v counts upwards", np.diag([1.0, -1.0, 1.0])),
    ImageAxes("u and v are exchanged", np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])),
)
"""Axes of mirrored images, which no rotation of the camera explains."""


@dataclass(frozen=True)
class CameraRecord:
    """Messages of one camera in a bag.

    Attributes:
        topic: topic of the camera's stars.
        camera: configured camera.
        messages: some of the messages, each with its arrival time, ns.
        predicted_attitude_at: function of a time that returns the predicted attitude (horizon from sensor), or None if
            unknown.
    """

    topic: str
    camera: CameraConfig
    messages: Sequence[tuple[Any, int]]
    predicted_attitude_at: Callable[[int], StarPrior | None]


def fit_camera(
    record: CameraRecord, axes: ImageAxes, sky_model: SkyModel
) -> tuple[CameraConfig | None, list[StarExposure]]:
    """Return the camera whose focal length fits the angles between stars, and the exposures with this camera.

    Returns:
        Camera and exposures. If too few stars are identified or the search does not converge, None and the exposures
        with the configured camera.
    """
    camera = record.camera
    for factor in _FIRST_FACTORS:
        fitted = _with_focal_length(camera, factor * camera.focal_length_m)
        for _ in range(_SEARCH_STEPS):
            exposures = _exposures(record, fitted, axes, sky_model)
            scale = _angle_ratio(exposures, sky_model)
            if scale is None:
                break
            if abs(scale - 1.0) < _SETTLED:
                return fitted, exposures
            fitted = _with_focal_length(fitted, scale * fitted.focal_length_m)
    return None, _exposures(record, camera, axes, sky_model)


def _exposures(record: CameraRecord, camera: CameraConfig, axes: ImageAxes, sky_model: SkyModel) -> list[StarExposure]:
    """Return the exposures that are not rejected and for which the sky is known, with stars identified if possible."""
    sensor, exposures = ExposingSensor(record.topic.split("/")[1], "", camera.camera("camera"), camera), []
    for message, receive_ns in record.messages:
        try:
            exposure = star_exposure(message, receive_ns, sensor, sky_model.catalogue).value
        except MessageRejected:
            continue
        sky = sky_model.sky_at(exposure.time_ns)
        if isinstance(sky, Rejection):
            continue
        if axes is not EXPECTED_AXES:
            exposure = replace(exposure, directions_s=exposure.directions_s @ axes.expected_s.T)
        prior = None if exposure.is_identified.all() else record.predicted_attitude_at(exposure.time_ns)
        if prior is not None:
            widened_n = prior.covariance_n + _PRIOR_SIGMA**2 * np.eye(3)
            unknown = np.full(len(exposure), np.nan)
            named, _ = identify_stars(
                replace(exposure, magnitude=unknown), StarPrior(prior.rotation_nb, widened_n), sky
            )
            exposure = replace(named, magnitude=exposure.magnitude)
        exposures.append(exposure)
    return exposures


def _with_focal_length(camera: CameraConfig, focal_length_m: float) -> CameraConfig:
    return replace(camera, focal_length_m=float(np.clip(focal_length_m, 0.001, 10.0)))


def _angle_ratio(exposures: list[StarExposure], sky_model: SkyModel) -> float | None:
    """Return the median ratio of measured to true angles between stars; None if there are too few pairs."""
    ratios: list[float] = []
    for exposure in exposures:
        named = exposure[exposure.is_identified]
        if len(named) < 2:
            continue
        sky = sky_model.sky_at(named.time_ns)
        assert not isinstance(sky, Rejection)
        places_n = sky.apparent_stars(named.positions).direction_n
        first, second = np.triu_indices(len(named), 1)
        true = angle_between(places_n[first], places_n[second])
        measured = angle_between(named.directions_s[first], named.directions_s[second])
        # A star too low for an apparent place gives a NaN angle, which is not used.
        ratios += (measured[true > _LEAST_PAIR_ANGLE] / true[true > _LEAST_PAIR_ANGLE]).tolist()
    return float(np.median(ratios)) if len(ratios) >= _FEWEST_PAIRS else None
