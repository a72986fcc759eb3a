"""Inputs and outputs of the optical-axis core: plain structs in radians, metres and nanoseconds."""

import enum
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import MeasurementDecision, Outcome, Status
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_geometry.tracks.exposure_mean import Nodes, exposure_nodes
from ship_geometry.tracks.sample_track import VectorSample
from ship_stars.attitude_from_stars.exposure import StarExposure


class Mode(enum.IntEnum):
    """Source of the pointing, with the values of ship_msgs/OpticalAxisPointing; TWO_LIGHTS means two or more."""

    TWO_LIGHTS = 0
    ONE_LIGHT = 1
    ENCODER = 2
    STARS = 3
    STARS_AND_LIGHTS = 4


@dataclass(frozen=True)
class EncoderSample(VectorSample):
    """One reading of both encoders; ``vector`` is (azimuth, elevation), rad.

    Attributes:
        sigma: noise of each angle, rad.
    """

    sigma: float

    def content(self) -> bytes:
        """See :meth:`VectorSample.content`."""
        sigma: bytes = np.float64(self.sigma).tobytes()
        return super().content() + sigma


@dataclass(frozen=True)
class ShipSample(AttitudeSample):
    """Ship's attitude at one time.

    Attributes:
        correlated_covariance_n: covariance of the correlated error, rotation vector in n, rad², shape (3, 3); None if
            the configuration states it.
        status: status stated by the source.
    """

    correlated_covariance_n: FloatArray | None = None
    status: Status = Status.VALID

    def content(self) -> bytes:
        """See :meth:`AttitudeSample.content`."""
        covariance = b"" if self.correlated_covariance_n is None else self.correlated_covariance_n.tobytes()
        return super().content() + covariance + bytes([self.status])


@dataclass(frozen=True)
class BaselineSample(VectorSample):
    """Baseline from the ship's antenna to a drone's antenna; ``vector`` is in (North, Up, East), m.

    Attributes:
        covariance_n: covariance of the baseline's white error, m², shape (3, 3).
        rejection: rejection of the baseline; None if it can be used. A rejected baseline is kept, so that no exposure
            waits for another baseline at its time.
    """

    covariance_n: FloatArray
    rejection: Rejection | None = None

    @cached_property
    def variance_m2(self) -> float:
        """Sum of the variances of all components; cached because several exposures use each sample."""
        return float(self.covariance_n.trace())

    def content(self) -> bytes:
        """See :meth:`VectorSample.content`."""
        return super().content() + self.covariance_n.tobytes() + repr(self.rejection).encode()


class _Image:
    """Image whose exposure has a known duration ``exposure_s``, or 0."""

    covariance_known: ClassVar[bool] = True
    """True for every image; ``ReadMessage`` records on reception whether the message states its sigma."""

    exposure_s: float

    @cached_property
    def nodes(self) -> Nodes | None:
        """Times for means over the exposure; None if its duration is unknown."""
        return exposure_nodes(self.exposure_s) if self.exposure_s > 0.0 else None

    @cached_property
    def reach_ns(self) -> int:
        """Time before and after the middle over which the rotation of telescope and ship must be known, ns."""
        return 0 if self.nodes is None else self.nodes.reach_ns


@dataclass(frozen=True)
class DetectedBeacon:
    """Beacon detected on the detector.

    Attributes:
        beacon_id: name of the beacon.
        point_m: detector point (x right, z up), shape (2,).
        sigma_m: standard deviation of x and of z.
    """

    beacon_id: str
    point_m: FloatArray
    sigma_m: float


@dataclass(frozen=True)
class Exposure(_Image):
    """One image of the calibration telescope.

    Attributes:
        time_ns: middle of the exposure.
        beacons: beacons in the order of their names, each name once.
        exposure_s: duration of the exposure; 0 if unknown.
    """

    source: ClassVar[str] = "beacons"

    time_ns: int
    beacons: tuple[DetectedBeacon, ...]
    exposure_s: float = 0.0

    def content(self) -> bytes:
        """Return all values as bytes, to detect repeated messages and to order conflicting messages."""
        lights = b"".join(
            light.beacon_id.encode() + light.point_m.tobytes() + np.float64(light.sigma_m).tobytes()
            for light in self.beacons
        )
        exposure: bytes = np.float64(self.exposure_s).tobytes()
        return lights + exposure


AnyExposure = Exposure | StarExposure
"""Input of the calibration filter: beacons, or stars of one camera."""


@dataclass(frozen=True)
class TargetSample(_Image):
    """One image of a target on the main detector.

    Attributes:
        time_ns: middle of the exposure.
        target_id: name of the target.
        point_m: detector point (x right, z up), shape (2,).
        sigma_m: standard deviation of x and of z.
        exposure_s: duration of the exposure; 0 if unknown.
        detector_rotation: rotation of the detector relative to the main frame, right side down, rad.
        range_m: distance from the theodolite's centre; NaN if unknown.
        range_sigma_m: standard deviation of the distance; NaN if unknown.
    """

    source: ClassVar[str] = "target"

    time_ns: int
    target_id: str
    point_m: FloatArray
    sigma_m: float
    exposure_s: float
    detector_rotation: float
    range_m: float
    range_sigma_m: float

    @property
    def has_range(self) -> bool:
        """True if the range and its standard deviation are known."""
        return self.range_m > 0.0 and self.range_sigma_m > 0.0

    def content(self) -> bytes:
        """Return all values as bytes, to detect repeated messages and to order conflicting messages."""
        numbers = self.sigma_m, self.exposure_s, self.detector_rotation, self.range_m, self.range_sigma_m
        return self.target_id.encode() + self.point_m.tobytes() + np.array(numbers).tobytes()


@dataclass(frozen=True)
class TargetEstimate:
    """Direction and position of a target at the time of its image; NaN if INVALID. Without a range the position is NaN.

    Attributes:
        time_ns: time of the image.
        target_id: name of the target.
        status: status of the direction.
        text: reason if the status is not VALID.
        direction_n: unit vector from the theodolite's centre to the target, shape (3,).
        covariance_n: covariance of the direction's total error, zero along the direction, rad², shape (3, 3).
        position_n: position from the ship's antenna, m, shape (3,).
        position_covariance_n: covariance of the position's total error, m², shape (3, 3).
    """

    time_ns: int
    target_id: str
    status: Status
    text: str
    direction_n: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    covariance_n: FloatArray = field(default_factory=lambda: np.full((3, 3), np.nan))
    position_n: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    position_covariance_n: FloatArray = field(default_factory=lambda: np.full((3, 3), np.nan))


@dataclass(frozen=True)
class ExposureDecision(MeasurementDecision[AnyExposure]):
    """Decision about an exposure.

    ``residual`` and ``sigma`` are angles. The angles of a beacon are x and z of the inverted image, positive to the
    left and down on the sky. The angles of a star are up and to the right on the sky. ``rejected_parts`` are beacons or
    stars. An exposure whose beacons had exchanged names is accepted, with the reason LIGHT_CONFLICT.

    Attributes:
        telescope_dt: deck from telescope, shape (3, 3), and the standard deviation about its worst axis, rad; None if
            not determined. The attitude comes from the beacons, or from the prediction if the beacons are consistent
            with the prediction.
        excluded_sources: sources that are excluded after the exposure.
    """

    telescope_dt: tuple[FloatArray, float] | None = None
    excluded_sources: tuple[str, ...] = ()


@dataclass(frozen=True)
class PointingEstimate:
    """Pointing of the main axis at one time; NaN if INVALID.

    Attributes:
        time_ns: time of validity.
        rotation_nm: horizon from main frame, shape (3, 3).
        covariance_by_source_n: error covariance by source, rotation vector in n, rad², shape (n_sources, 3, 3).
        covariance_n: total covariance, with the inflation by solution separations, rad², shape (3, 3).
        covariance_without_separation_n: total covariance without this inflation, for the protection levels.
        rotation_nt: horizon from telescope, shape (3, 3); NaN without recent beacons (modes ENCODER and STARS).
        mode: source of the pointing.
        status: status of the pointing.
        light_count: number of beacons in the last accepted sighting; 0 if it is not recent.
        state: state of the filter from which the pointing was computed.
        text: reason if the status is not VALID.
        by_error_n: derivative of the main axis' rotation vector in n with respect to the axis geometry's errors, shape
            (3, k).
        rotation_dm: deck from main frame, shape (3, 3). The deck is the attitude that tf2 interpolates, so that tf2
            computes ``rotation_nm`` from this attitude and ``rotation_dm``. NaN without ship/attitude.
    """

    time_ns: int
    rotation_nm: FloatArray
    covariance_by_source_n: FloatArray
    covariance_n: FloatArray
    covariance_without_separation_n: FloatArray
    rotation_nt: FloatArray
    mode: Mode
    status: Status
    light_count: int
    state: Any = field(repr=False)
    text: str
    by_error_n: FloatArray
    rotation_dm: FloatArray


@dataclass
class PointingOutcome(Outcome[Any, PointingEstimate]):
    """Result of one input of the optical-axis core.

    Decisions are about exposures of beacons and stars, and about images of targets.

    Attributes:
        targets: directions of targets. An image without a pointing gives an INVALID direction and a rejection.
    """

    targets: list[TargetEstimate] = field(default_factory=list)
