"""Camera parameters from stars: image axes, focal length, principal point, magnitudes and attitudes.

Axes, focal length and principal point follow from the angles between identified stars in the exposures of a bag. A
predicted attitude is needed only to identify stars without a catalogue number, and to decide which axis of a mirrored
image is reversed. The magnitudes of stars without a catalogue number are not used for identification, because the
magnitudes may be wrong.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any, NamedTuple

import numpy as np

from ship_attitude_star.star_attitude.exposure_solver import PlacedExposure, solve_exposure
from ship_estimation.rejection_rules import Rejection
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, log_rotation
from ship_node.messages.field_checks import MessageRejected
from ship_stars.attitude_from_stars.exposure import StarExposure, identify_stars
from ship_stars.attitude_from_stars.field_scale import OpticsEstimate, estimate_optics, field_information
from ship_stars.attitude_from_stars.selection import MIN_VERIFIED_STARS, StarPrior
from ship_stars.attitude_from_stars.solution import SolutionStatus, StarSolution
from ship_stars.camera.config import CameraConfig
from ship_stars.messages.star_messages import ExposingSensor, star_exposure
from ship_stars.sky.catalogue import UNKNOWN
from ship_stars.sky.sky_model import SkyModel

_FEWEST_PAIRS = 5
_LEAST_PAIR_ANGLE = np.deg2rad(0.2)
_FIRST_FACTORS = 1.0, 0.1, 10.0
_SEARCH_STEPS, _SETTLED = 8, 1e-4

_PRIOR_SIGMA = 60.0 * ARCSEC
"""Sigma added to the predicted attitude about each axis, rad: displacement of a star 3° off axis if the focal length is
wrong by 0.5 %."""

_FEWEST_MAGNITUDES = 5

_MIN_STAR_SHARE = 0.5
"""Image axes are accepted if at least this share of the stars is consistent with one attitude per exposure."""

_AMBIGUOUS_AXES = "u or v is reversed, or both are exchanged"
"""Text for mirrored axes that the stars alone cannot distinguish: they differ only by a rotation of the camera."""


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


class MagnitudeOffset(NamedTuple):
    """Magnitudes of a camera relative to the catalogue.

    Attributes:
        offset: median of measured minus catalogue magnitude (Hp).
        sigma: standard deviation of the offset.
    """

    offset: float
    sigma: float


@dataclass(frozen=True)
class MeasuredCamera:
    """Camera parameters measured from stars.

    Attributes:
        axes: image axes.
        focal_length_m: focal length from the angles between stars; None if not determined.
        optics: correction of the configured focal length and principal point; None if not determined.
        magnitudes: magnitude offset; None if too few stars have a magnitude.
        attitudes: times and attitudes (horizon from sensor).
    """

    axes: ImageAxes
    focal_length_m: float | None
    optics: OpticsEstimate | None
    magnitudes: MagnitudeOffset | None
    attitudes: list[tuple[int, FloatArray]]


@dataclass(frozen=True)
class _AxesHypothesis:
    """Exposures of a camera under one hypothesis about its axes.

    Attributes:
        axes: assumed axes.
        camera: camera with the focal length that fits the angles between stars; None if :func:`fit_camera` finds none.
        solutions: exposures with an attitude, each with its attitude.
        star_count: number of stars in all exposures.
    """

    axes: ImageAxes
    camera: CameraConfig | None
    solutions: list[tuple[PlacedExposure, StarSolution]]
    star_count: int

    @property
    def used_count(self) -> int:
        """Number of stars consistent with the attitude of their exposure, over all verified solutions."""
        return sum(solution.star_count for _, solution in self.verified_solutions)

    @property
    def verified_solutions(self) -> list[tuple[PlacedExposure, StarSolution]]:
        """Exposures in which the stars verify one another."""
        return [entry for entry in self.solutions if entry[1].star_count >= MIN_VERIFIED_STARS]

    def median_rotation(self, record: CameraRecord) -> float:
        """Return the median angle between measured and predicted attitudes, rad; NaN without predictions."""
        pairs = [
            (record.predicted_attitude_at(placed.time_ns), solution.rotation_nb)
            for placed, solution in self.verified_solutions
        ]
        angles = [
            float(np.linalg.norm(log_rotation(prior.rotation_nb.T @ rotation_ns)))
            for prior, rotation_ns in pairs
            if prior is not None
        ]
        return float(np.median(angles)) if angles else np.nan


def measure_camera(record: CameraRecord, sky_model: SkyModel) -> MeasuredCamera:
    """Return the parameters of a camera from its stars.

    Args:
        record: messages of the camera.
        sky_model: model of the sky, with place and air.
    """
    hypothesis = _evaluate_axes(record, EXPECTED_AXES, sky_model)
    if hypothesis.used_count < _MIN_STAR_SHARE * hypothesis.star_count:
        hypothesis = _best_mirrored(record, hypothesis, sky_model)
    optics = _optics(record.camera, hypothesis)
    return MeasuredCamera(
        axes=hypothesis.axes,
        focal_length_m=_focal_length_m(record.camera, hypothesis, optics),
        optics=optics,
        magnitudes=_magnitudes(hypothesis, sky_model),
        attitudes=[(placed.time_ns, solution.rotation_nb) for placed, solution in hypothesis.solutions],
    )


def _best_mirrored(record: CameraRecord, expected: _AxesHypothesis, sky_model: SkyModel) -> _AxesHypothesis:
    """Return the hypothesis of mirrored axes that fits the stars; return ``expected`` if no mirrored axes fit.

    If several hypotheses fit, the hypothesis nearest to the predicted attitudes is returned.
    """
    found = [reading for axes in MIRRORED if _explains(reading := _evaluate_axes(record, axes, sky_model), expected)]
    nearest = min(found, key=lambda reading: reading.median_rotation(record), default=expected)
    if found and np.isnan(nearest.median_rotation(record)):
        return replace(nearest, axes=nearest.axes._replace(text=_AMBIGUOUS_AXES))
    return nearest


def _explains(mirrored: _AxesHypothesis, expected: _AxesHypothesis) -> bool:
    """True if most stars are consistent with the mirrored axes, and far fewer stars with the expected axes."""
    least = max(_MIN_STAR_SHARE * mirrored.star_count, 2 * expected.used_count, MIN_VERIFIED_STARS)
    return mirrored.used_count >= least


def _evaluate_axes(record: CameraRecord, axes: ImageAxes, sky_model: SkyModel) -> _AxesHypothesis:
    camera, exposures = fit_camera(record, axes, sky_model)
    results = [solve_exposure(exposure, (), None, sky_model) for exposure in exposures]
    solved = [(placed, result.solution) for placed, result in results]
    return _AxesHypothesis(
        axes,
        camera,
        [entry for entry in solved if entry[1].status is not SolutionStatus.INVALID],
        sum(map(len, exposures)),
    )


def _optics(configured: CameraConfig, hypothesis: _AxesHypothesis) -> OpticsEstimate | None:
    """Return the correction of the configured optics by least squares over the angles between stars."""
    if hypothesis.camera is None:
        return None
    fitted = hypothesis.camera.camera("camera")
    fields = [
        field_information(fitted, placed.stars, solution.members)
        for placed, solution in hypothesis.verified_solutions
        if placed.stars is not None
    ]
    known = [field for field in fields if field is not None]
    found = estimate_optics(reduce(add, known)) if known else None
    if found is None or not found.degrees:
        return None
    focal_length_m = fitted.focal_length_m * (1.0 + found.scale)
    # The covariance is inflated if centroids are worse than stated, so that their errors count as noise.
    return replace(
        found,
        scale=focal_length_m / configured.focal_length_m - 1.0,
        covariance=found.covariance * max(found.chi_square / found.degrees, 1.0),
    )


def _focal_length_m(
    configured: CameraConfig, hypothesis: _AxesHypothesis, optics: OpticsEstimate | None
) -> float | None:
    if optics is not None:
        return configured.focal_length_m * (1.0 + optics.scale)
    return None if hypothesis.camera is None else hypothesis.camera.focal_length_m


def _magnitudes(hypothesis: _AxesHypothesis, sky_model: SkyModel) -> MagnitudeOffset | None:
    """Return the magnitude offset of stars consistent with the attitude of their exposure."""
    differences: dict[int, list[float]] = {}
    for placed, solution in hypothesis.verified_solutions:
        used = placed.exposure[solution.members]
        rows = sky_model.catalogue.rows(used.hip)
        for hip, row, magnitude in zip(used.hip.tolist(), rows.tolist(), used.magnitude.tolist(), strict=True):
            if row != UNKNOWN and np.isfinite(magnitude):
                differences.setdefault(hip, []).append(magnitude - float(sky_model.catalogue.magnitude[row]))
    if len(differences) < _FEWEST_MAGNITUDES:
        return None
    # One value per star, because the effect of a star's colour is the same in all exposures.
    of_stars = np.array([np.median(values) for values in differences.values()])
    offset = float(np.median(of_stars))
    spread = 1.4826 * float(np.median(np.abs(of_stars - offset)))
    return MagnitudeOffset(offset, float(1.2533 * spread / np.sqrt(len(of_stars))))
