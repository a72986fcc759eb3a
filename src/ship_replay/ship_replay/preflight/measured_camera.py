"""A camera by its stars: axes of the image, focal length, principal point, magnitudes; and the attitudes they give.

Stars with names need nothing else. Stars without names are identified by the attitude that the INS predicts for the
camera, without their magnitudes: these are compared afterwards. Axes, focal length and principal point need no
attitude; only a mirrored image needs one to state which of its axes is reversed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any, NamedTuple

import numpy as np

from ship_attitude_star.ros.star_messages_in import star_exposure
from ship_attitude_star.sky.catalogue import UNKNOWN
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.star_attitude.exposure_solver import PlacedExposure, solve_exposure
from ship_attitude_star.stars.config import CameraConfig
from ship_attitude_star.stars.exposure import StarExposure, identified
from ship_attitude_star.stars.field_scale import OpticsEstimate, estimate_optics, field_information
from ship_attitude_star.stars.selection import FEWEST_VERIFIED, StarPrior
from ship_attitude_star.stars.solution import SolutionStatus, StarSolution
from ship_estimation.refusals import Refusal
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, log_rotation
from ship_node.edge.messages_in import Refused

_FEWEST_PAIRS = 5
_LEAST_PAIR_ANGLE = np.deg2rad(0.2)
_FIRST_FACTORS = 1.0, 0.1, 10.0
_SEARCH_STEPS, _SETTLED = 8, 1e-4
_FEWEST_MAGNITUDES = 5

_PRIOR_SIGMA = 60.0 * ARCSEC
"""Added to the predicted attitude, each axis: a focal length off by 0.5 % displaces a star at 3° from the middle so."""

_MOST_OF_THE_STARS = 0.5
"""Share of the stars that must agree on one attitude per exposure for the axes of an image to be the right ones."""


class ImageAxes(NamedTuple):
    """How u and v of a camera may be meant.

    Attributes:
        text: the difference to what is expected, for people; empty for none.
        expected_s: expected from measured direction (forward, up, right), shape (3, 3).
    """

    text: str
    expected_s: FloatArray


AS_EXPECTED = ImageAxes("", np.eye(3))

MIRRORED = (
    ImageAxes("u counts to the left", np.diag([1.0, 1.0, -1.0])),
    ImageAxes("v counts upwards", np.diag([1.0, -1.0, 1.0])),
    ImageAxes("u and v are exchanged", np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])),
)
"""Images that no turn of the camera explains."""


class MagnitudeOffset(NamedTuple):
    """Magnitudes of a camera against the catalogue's.

    Attributes:
        offset: median of measured minus catalogue (Hp).
        sigma: standard deviation of the offset.
    """

    offset: float
    sigma: float


@dataclass(frozen=True)
class CameraRecord:
    """What a bag holds of one camera.

    Attributes:
        topic: of its stars.
        camera: as configured.
        messages: some of them, each with its arrival, ns.
        prior_at: attitude of the camera (horizon from sensor) at a time; None where it is not known.
    """

    topic: str
    camera: CameraConfig
    messages: Sequence[tuple[Any, int]]
    prior_at: Callable[[int], StarPrior | None]


@dataclass(frozen=True)
class MeasuredCamera:
    """A camera as its stars show it.

    Attributes:
        axes: of its image.
        focal_length_m: by the angles between stars; None where too few stars have identities.
        optics: correction of the focal length and of the principal point as configured; None where not determined.
        magnitudes: None where too few are given.
        attitudes: times and attitudes (horizon from sensor).
    """

    axes: ImageAxes
    focal_length_m: float | None
    optics: OpticsEstimate | None
    magnitudes: MagnitudeOffset | None
    attitudes: list[tuple[int, FloatArray]]


@dataclass(frozen=True)
class _Reading:
    """The exposures of a camera under one assumption about its axes.

    Attributes:
        axes: the assumption.
        camera: with the focal length that fits the angles between stars; None where there are too few.
        solved: exposures with an attitude, and the attitude.
        star_count: number of stars in all exposures.
    """

    axes: ImageAxes
    camera: CameraConfig | None
    solved: list[tuple[PlacedExposure, StarSolution]]
    star_count: int

    @property
    def used(self) -> int:
        """Number of stars that agree with the attitudes of their exposures, where other stars verify these."""
        return sum(solution.star_count for _, solution in self.verified)

    @property
    def verified(self) -> list[tuple[PlacedExposure, StarSolution]]:
        """Exposures in which the stars verify one another."""
        return [entry for entry in self.solved if entry[1].star_count >= FEWEST_VERIFIED]

    def turn(self, record: CameraRecord) -> float:
        """Median angle between the attitudes and the predicted ones, rad; 0 where none is predicted."""
        pairs = [(record.prior_at(placed.time_ns), solution.rotation_nb) for placed, solution in self.verified]
        turns = [
            float(np.linalg.norm(log_rotation(prior.rotation_nb.T @ rotation_ns)))
            for prior, rotation_ns in pairs
            if prior is not None
        ]
        return float(np.median(turns)) if turns else 0.0


def measure_camera(record: CameraRecord, watch: SkyWatch) -> MeasuredCamera:
    """Return a camera as its stars show it.

    Args:
        record: its stars.
        watch: the sky, with place and air.
    """
    reading = _read(record, AS_EXPECTED, watch)
    if reading.used < _MOST_OF_THE_STARS * reading.star_count:
        mirrored = [other for axes in MIRRORED if _explains(other := _read(record, axes, watch), reading)]
        reading = min(mirrored, key=lambda other: other.turn(record), default=reading)
    optics = _optics(record.camera, reading)
    return MeasuredCamera(
        axes=reading.axes,
        focal_length_m=_focal_length_m(record.camera, reading, optics),
        optics=optics,
        magnitudes=_magnitudes(reading, watch),
        attitudes=[(placed.time_ns, solution.rotation_nb) for placed, solution in reading.solved],
    )


def _explains(mirrored: _Reading, expected: _Reading) -> bool:
    """True if most stars agree with the mirrored axes, and far fewer with the expected ones."""
    return mirrored.used >= max(_MOST_OF_THE_STARS * mirrored.star_count, 2 * expected.used, FEWEST_VERIFIED)


def _read(record: CameraRecord, axes: ImageAxes, watch: SkyWatch) -> _Reading:
    camera, exposures = _fitted_camera(record, axes, watch)
    results = [solve_exposure(exposure, (), None, watch) for exposure in exposures]
    solved = [(placed, result.solution) for placed, result in results]
    return _Reading(
        axes,
        camera,
        [entry for entry in solved if entry[1].status is not SolutionStatus.INVALID],
        sum(map(len, exposures)),
    )


def _exposures(record: CameraRecord, camera: CameraConfig, axes: ImageAxes, watch: SkyWatch) -> list[StarExposure]:
    """Return the exposures whose time and place are known well enough for a sky, their stars identified if possible."""
    sensor_id, exposures = record.topic.split("/")[1], []
    geometry = camera.camera("camera")
    for message, receive_ns in record.messages:
        try:
            exposure = star_exposure(message, sensor_id, "", geometry, camera, watch.catalogue, receive_ns).value
        except Refused:
            continue
        moment = watch.at(exposure.time_ns)
        if isinstance(moment, Refusal):
            continue
        if axes is not AS_EXPECTED:
            exposure = replace(exposure, directions_s=exposure.directions_s @ axes.expected_s.T)
        prior = None if exposure.identified.all() else record.prior_at(exposure.time_ns)
        if prior is not None:
            widened_n = prior.covariance_n + _PRIOR_SIGMA**2 * np.eye(3)
            unknown = np.full(len(exposure), np.nan)
            named, _ = identified(
                replace(exposure, magnitude=unknown), StarPrior(prior.rotation_nb, widened_n), moment
            )
            exposure = replace(named, magnitude=exposure.magnitude)
        exposures.append(exposure)
    return exposures


def _fitted_camera(
    record: CameraRecord, axes: ImageAxes, watch: SkyWatch
) -> tuple[CameraConfig | None, list[StarExposure]]:
    """Return the camera whose focal length makes the angles between stars those of the sky, and the exposures by it.

    Returns:
        None for the camera where too few stars have identities: the exposures are then by the camera as configured.
    """
    camera = record.camera
    for factor in _FIRST_FACTORS:
        fitted = _with_focal_length(camera, factor * camera.focal_length_m)
        for _ in range(_SEARCH_STEPS):
            exposures = _exposures(record, fitted, axes, watch)
            scale = _scale(exposures, watch)
            if scale is None:
                break
            if abs(scale - 1.0) < _SETTLED:
                return fitted, exposures
            fitted = _with_focal_length(fitted, scale * fitted.focal_length_m)
    return None, _exposures(record, camera, axes, watch)


def _with_focal_length(camera: CameraConfig, focal_length_m: float) -> CameraConfig:
    return replace(camera, focal_length_m=float(np.clip(focal_length_m, 0.001, 10.0)))


def _scale(exposures: list[StarExposure], watch: SkyWatch) -> float | None:
    """Return the median ratio of measured to true angles between stars; None where there are too few pairs."""
    ratios: list[float] = []
    for exposure in exposures:
        named = exposure[exposure.identified]
        if len(named) < 2:
            continue
        moment = watch.at(named.time_ns)
        assert not isinstance(moment, Refusal)
        places_n = moment.apparent(named.positions).direction_n
        first, second = np.triu_indices(len(named), 1)
        true = angle_between(places_n[first], places_n[second])
        measured = angle_between(named.directions_s[first], named.directions_s[second])
        # Where a place is not known (too low) the angle is NaN, and not used.
        ratios += (measured[true > _LEAST_PAIR_ANGLE] / true[true > _LEAST_PAIR_ANGLE]).tolist()
    return float(np.median(ratios)) if len(ratios) >= _FEWEST_PAIRS else None


def _optics(configured: CameraConfig, reading: _Reading) -> OpticsEstimate | None:
    """Return the correction of the configured optics by least squares over the angles between stars."""
    if reading.camera is None:
        return None
    fitted = reading.camera.camera("camera")
    fields = [
        field_information(fitted, placed.stars, solution.members)
        for placed, solution in reading.verified
        if placed.stars is not None
    ]
    known = [field for field in fields if field is not None]
    found = estimate_optics(reduce(add, known)) if known else None
    if found is None or not found.degrees:
        return None
    focal_length_m = fitted.focal_length_m * (1.0 + found.scale)
    # Centroids worse than stated must not make a contradiction of the optics.
    return replace(
        found,
        scale=focal_length_m / configured.focal_length_m - 1.0,
        covariance=found.covariance * max(found.chi_square / found.degrees, 1.0),
    )


def _focal_length_m(configured: CameraConfig, reading: _Reading, optics: OpticsEstimate | None) -> float | None:
    if optics is not None:
        return configured.focal_length_m * (1.0 + optics.scale)
    return None if reading.camera is None else reading.camera.focal_length_m


def _magnitudes(reading: _Reading, watch: SkyWatch) -> MagnitudeOffset | None:
    """Return the offset of the magnitudes of stars that agree with the attitude of their exposure."""
    differences: dict[int, list[float]] = {}
    for placed, solution in reading.verified:
        used = placed.exposure[solution.members]
        rows = watch.catalogue.rows(used.hip)
        for hip, row, magnitude in zip(used.hip.tolist(), rows.tolist(), used.magnitude.tolist(), strict=True):
            if row != UNKNOWN and np.isfinite(magnitude):
                differences.setdefault(hip, []).append(magnitude - float(watch.catalogue.magnitude[row]))
    if len(differences) < _FEWEST_MAGNITUDES:
        return None
    # The colour of a star is the same in all exposures.
    of_stars = np.array([np.median(values) for values in differences.values()])
    offset = float(np.median(of_stars))
    spread = 1.4826 * float(np.median(np.abs(of_stars - offset)))
    return MagnitudeOffset(offset, float(1.2533 * spread / np.sqrt(len(of_stars))))
