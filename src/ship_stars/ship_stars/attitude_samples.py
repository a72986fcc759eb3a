"""Inputs and outputs of the cores, as plain data classes in radians, metres and nanoseconds.

Inputs are attitudes of star sensors and star trackers, position fixes, readings of the air, and deflections of the
vertical. Outputs are measurement decisions and attitudes of the ship. The stars of an exposure are in
:class:`ship_stars.attitude_from_stars.exposure.StarExposure`.
"""

import enum
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from ship_estimation.plausibility.stuck_check import StuckValue, largest_sigma
from ship_estimation.time_order.outcome import Measurement, MeasurementDecision, Outcome, Status
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.earth.time_scales import StampArray
from ship_geometry.rotations import FloatArray

SHARED_BY_SKY = "sky"
"""Name of the errors that all sensors share through the sky model: refraction, UT1, position and UTC."""

SHARED_BY_MESSAGES = "message"
"""Name of an error that is common to several messages; only its covariance is known."""

SHARED_BY_GRAVITY = "gravity"
"""Name of the deflection of the vertical, which all systems levelled by gravity share."""

ATTITUDE_COMPONENTS = ("forward", "up", "right")
"""Components of the residual of an attitude: rotation vector in the device frame."""


class CheckedMeasurement(Measurement, Protocol):
    """A measurement with a value that must not stay constant."""

    @property
    def stuck_value(self) -> StuckValue:
        """Value that varies while the ship rotates."""
        ...


@dataclass(frozen=True)
class FieldOfView:
    """Field of view of a star tracker.

    Attributes:
        radius: radius of the field, rad; 0 if all stars are assumed at the boresight.
        aberration_removed: True if the attitude of the tracker is already corrected for annual aberration.
    """

    radius: float = 0.0
    aberration_removed: bool = True


AT_BORESIGHT = FieldOfView()
"""Field of view with all stars at the boresight, aberration corrected."""


@dataclass(frozen=True)
class InertialAttitude:
    """Attitude of a star tracker relative to the ICRS.

    Attributes:
        source: name of the tracker, ``star.<id>``.
        time_ns: stamp of the tracker's message, the middle of the exposure.
        rotation_cs: rotation "ICRS from sensor (forward, up, right)", shape (3, 3).
        noise_s: error covariance, rotation vector in the sensor frame, rad², shape (3, 3).
        covariance_known: False if the message has no covariance, so that the configured sigma is used.
        field: field of view of the tracker.
    """

    source: str
    time_ns: int
    rotation_cs: FloatArray
    noise_s: FloatArray
    covariance_known: bool = True
    reach_ns = 0  # no motion data before or after its time are needed
    field: FieldOfView = AT_BORESIGHT

    def content(self) -> bytes:
        """Return all values as bytes, to recognise a repeated message and to sort conflicting messages."""
        return self.rotation_cs.tobytes() + self.noise_s.tobytes()

    @property
    def stuck_value(self) -> StuckValue:
        """Value that must not stay constant; a ship at rest rotates relative to the stars."""
        return StuckValue(self.rotation_cs, largest_sigma(self.noise_s), "attitude relative to the stars is constant")


@dataclass(frozen=True)
class PositionFix:
    """Ship position from a GNSS receiver.

    Attributes:
        time_ns: stamp of the fix.
        position: position of the antenna.
        covariance_m2: covariance of the position in (North, Up, East), m², shape (3, 3).
    """

    source: ClassVar[str] = "gnss/fix"

    time_ns: int
    position: GeodeticPosition
    covariance_m2: FloatArray


@dataclass(frozen=True)
class AirReading:
    """Reading of one air quantity from a weather station.

    Attributes:
        quantity: ``pressure`` (hPa, at the ship, not reduced to sea level), ``temperature`` (°C, of the outside air)
            or ``humidity`` (relative, 0 to 1).
        time_ns: stamp of the reading.
        value: value in the unit of the quantity.
        sigma: standard deviation of the value; None if the message has no variance.
    """

    quantity: str
    time_ns: int
    value: float
    sigma: float | None = None

    @property
    def source(self) -> str:
        """Name of the source, which is the name of the quantity."""
        return self.quantity


SkyInput = PositionFix | AirReading
"""Input of the sky model."""


@dataclass(frozen=True)
class DeflectionReading:
    """Deflection of the vertical at the ship, from a gravity model.

    Attributes:
        time_ns: stamp of the reading.
        deflection: deflection (xi, eta) of the gravity zenith, northward and eastward, rad, shape (2,).
        covariance: error covariance of the deflection, rad², shape (2, 2); None if the message has no covariance.
    """

    source: ClassVar[str] = "gravity/deflection"

    time_ns: int
    deflection: FloatArray
    covariance: FloatArray | None = None

    def content(self) -> bytes:
        """Return all values as bytes, to recognise a repeated message and to sort conflicting messages."""
        return self.deflection.tobytes() + (b"" if self.covariance is None else self.covariance.tobytes())


class Horizon(enum.IntEnum):
    """Horizon of an attitude: geodetic (Up is the ellipsoid normal) or of local gravity (Up is opposite to gravity)."""

    GEODETIC = 0
    GRAVITY = 1


@dataclass(frozen=True)
class AttitudeMeasurement:
    """Attitude of a device fixed to the ship: a star sensor, or another attitude system.

    Attributes:
        source: name of the device, ``star.<id>`` or ``reference.<name>``.
        time_ns: stamp of the device.
        rotation_nv: attitude (horizon from device: forward, up, right), shape (3, 3).
        noise_v: covariance of the error that is independent in each measurement, rotation vector in the device frame,
            rad², shape (3, 3).
        common_n: covariance of the error that is common to successive measurements, rotation vector in the horizon
            frame, rad², shape (3, 3).
        covariance_known: False if the message has no covariance, so that the configured sigma is used.
        shared_n: rotation in the horizon frame by one standard deviation of each of n errors shared with other sensors,
            rad, shape (3, n); None without such errors.
        shared_by: kind of the shared errors. SHARED_BY_SKY: n = 4, or 5 with UTC
            (:data:`ship_stars.sky.sky_model.SHARED_TERMS`). SHARED_BY_MESSAGES: n = 3. SHARED_BY_GRAVITY:
            n = 2; the rotations are per radian of deflection.
    """

    source: str
    time_ns: int
    rotation_nv: FloatArray
    noise_v: FloatArray
    common_n: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    covariance_known: bool = True
    shared_n: FloatArray | None = None
    shared_by: str = SHARED_BY_SKY
    reach_ns = 0  # no motion data before or after the stamp are needed

    def content(self) -> bytes:
        """Return rotation and covariances as bytes, to recognise repeated and to sort conflicting messages."""
        shared = b"" if self.shared_n is None else self.shared_n.tobytes()
        return self.rotation_nv.tobytes() + self.noise_v.tobytes() + self.common_n.tobytes() + shared

    @property
    def stuck_value(self) -> StuckValue:
        """Value that must not stay constant while the ship rotates."""
        return StuckValue(self.rotation_nv, largest_sigma(self.noise_v), "attitude is constant", is_attitude=True)

    @property
    def correlated_n(self) -> FloatArray:
        """Covariance of all errors that are correlated between measurements, horizon frame, rad², shape (3, 3)."""
        return self.common_n if self.shared_n is None else self.common_n + self.shared_n @ self.shared_n.T


@dataclass(frozen=True)
class SolvedAttitude(AttitudeMeasurement):
    """Attitude that a sensor computed with position, UT1 and air data; their errors are not separated yet.

    The errors shared with other sensors are part of ``common_n``, or of ``noise_v`` if the message has no separate
    noise covariance.

    Attributes:
        has_noise_covariance: False if the message has only one covariance for all errors.
    """

    has_noise_covariance: bool = True


@dataclass(frozen=True)
class AttitudeDecision(MeasurementDecision[Measurement]):
    """Decision about a measurement of the ship filter.

    ``components`` are ATTITUDE_COMPONENTS, BASELINE_COMPONENTS, or for each star used "HIP 92420 up" and
    "HIP 92420 right".

    Attributes:
        ins_time_ns: latest INS stamp that the decision depends on.
    """

    ins_time_ns: int = 0


@dataclass(frozen=True)
class AttitudeEstimate:
    """The ship attitude at one time.

    Attributes:
        time_ns: time of validity.
        rotation_nd: attitude (horizon from deck), shape (3, 3); NaN if INVALID.
        covariance_by_source_n: error covariance by error source, rotation vector in the horizon frame, rad²,
            shape (n_sources, 3, 3).
        covariance_n: total error covariance, shape (3, 3).
        covariance_without_separation_n: error covariance without the inflation for solution separations, for the
            protection levels.
        status: status of the attitude.
        horizon: horizon of the attitude.
        sources: sources of the attitude, for example ``("ins", "star.fore")``.
        star_age_s: time since the last accepted star measurement, s; NaN before the first.
        state: filter state from which the attitude was computed.
        rate_d: angular velocity in the deck frame, rad/s, shape (3,); NaN if not known.
        text: reason for DEGRADED or INVALID; else empty.
    """

    time_ns: int
    rotation_nd: FloatArray
    covariance_by_source_n: FloatArray
    covariance_n: FloatArray
    covariance_without_separation_n: FloatArray
    status: Status
    horizon: Horizon
    sources: tuple[str, ...]
    star_age_s: float
    rate_d: FloatArray
    state: Any = field(repr=False)
    text: str = ""


@dataclass(frozen=True)
class AttitudeSeries:
    """Ship attitudes at N times with one filter state.

    Attributes:
        time_ns: times in ascending order, shape (N,).
        rotation_nd: as in :class:`AttitudeEstimate`, shape (N, 3, 3).
        covariance_by_source_n: likewise, shape (N, n_sources, 3, 3).
        covariance_n: likewise, shape (N, 3, 3).
        covariance_without_separation_n: likewise, shape (N, 3, 3).
        rate_d: likewise, shape (N, 3).
        status: status of each attitude.
        horizon: horizon of each attitude, shape (N,).
        sources: sources of each attitude.
        star_age_s: as in :class:`AttitudeEstimate`, shape (N,).
        state: filter state from which all attitudes were computed.
        text: text of each attitude.
    """

    time_ns: StampArray
    rotation_nd: FloatArray
    covariance_by_source_n: FloatArray
    covariance_n: FloatArray
    covariance_without_separation_n: FloatArray
    rate_d: FloatArray
    status: list[Status]
    horizon: NDArray[np.int64]
    sources: list[tuple[str, ...]]
    star_age_s: FloatArray
    state: Any = field(repr=False)
    text: list[str]

    def subset(self, indices: slice) -> "AttitudeSeries":
        """Return a slice of the series."""
        return AttitudeSeries(**self._fields_at(indices))

    def estimate(self, index: int) -> AttitudeEstimate:
        """Return one attitude of the series."""
        at = self._fields_at(index)
        at |= {"time_ns": int(at["time_ns"]), "horizon": Horizon(at["horizon"]), "star_age_s": float(at["star_age_s"])}
        return AttitudeEstimate(**at)

    def _fields_at(self, which: int | slice) -> dict[str, Any]:
        return {name: value if name == "state" else value[which] for name, value in vars(self).items()}


AttitudeOutcome = Outcome[AttitudeDecision, AttitudeEstimate]
"""Outcome of one input of the core."""
