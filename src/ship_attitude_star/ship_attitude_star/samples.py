"""What goes into the ship-attitude core and what comes out: plain structs in radians, metres and nanoseconds."""

import enum
from dataclasses import dataclass, field

import numpy as np

from ship_geometry.rotations import FloatArray


class Status(enum.IntEnum):
    """Status of an attitude; the values are those of ship_msgs/ShipAttitude."""

    VALID = 0
    COASTING = 1
    DEGRADED = 2
    INVALID = 3


class Horizon(enum.IntEnum):
    """What "up" means: the ellipsoid normal by the stars, or the local gravity by the INS alone."""

    GEODETIC = 0
    GRAVITY = 1


class Reason(enum.IntEnum):
    """Why a measurement was not used; the values are those of ship_msgs/Innovation."""

    NONE = 0
    NON_FINITE = 1
    BAD_QUATERNION = 2
    COVARIANCE_UNKNOWN = 3
    BAD_COVARIANCE = 4
    BAD_STAMP = 5
    DUPLICATE = 6
    CONFLICT = 7
    LATE = 8
    FUTURE = 9
    FRAME = 10
    UNITS = 11
    STUCK = 12
    NOT_FIXED = 13
    MISIDENTIFIED = 14
    TOO_FEW_STARS = 15
    ATTITUDE_CONFLICT = 16
    LIGHT_CONFLICT = 17
    OVERFLOW = 18
    GATE = 19
    REVISED = 20
    GAP = 21
    NO_FIX = 22
    NO_EARTH_ORIENTATION = 23
    UNKNOWN_STAR = 24
    BELOW_HORIZON = 25
    UNIDENTIFIED = 26
    UNKNOWN_SENSOR = 27


@dataclass(frozen=True)
class Refusal:
    """Why an input was not used at all."""

    reason: Reason
    text: str


def same_stamp(known: bytes, new: bytes) -> Refusal:
    """The refusal of a second input with the same stamp; ``known`` and ``new`` are their contents."""
    if known == new:
        return Refusal(Reason.DUPLICATE, "the same stamp and the same content again")
    return Refusal(Reason.CONFLICT, "the same stamp with other content: the one whose bytes sort first is kept")


@dataclass(frozen=True)
class AttitudeMeasurement:
    """The attitude of a device fixed to the ship: a star sensor, or another attitude system.

    Attributes:
        source: ``star.<id>`` or ``reference.<name>``.
        time_ns: stamp of the device.
        rotation_nv: horizon from device (forward, up, right), shape (3, 3).
        noise_v: covariance, independent from epoch to epoch, in the device frame, rad², shape (3, 3).
        common_n: covariance of what epochs share, rotation vector in the horizon frame, rad², shape (3, 3).
        covariance_known: False where the message gave none and the configured sigma stands in.
    """

    source: str
    time_ns: int
    rotation_nv: FloatArray
    noise_v: FloatArray
    common_n: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    covariance_known: bool = True

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        return self.rotation_nv.tobytes() + self.noise_v.tobytes() + self.common_n.tobytes()


@dataclass(frozen=True)
class Decision:
    """What became of a measurement.

    Attributes:
        measurement: the measurement itself.
        ins_time_ns: the stamp of the INS to which it was compared.
        residual_v: measured minus predicted attitude, rotation vector in the device frame, rad; NaN where it
            was not compared at all.
        sigma_v: predicted standard deviation of the residual, rad.
        nis: normalised innovation squared, chi² with three degrees of freedom.
        gate: the value that ``nis`` must not exceed.
        reason: why it was not used; NONE where it was.
        revised: True where a measurement that arrived late changed an earlier decision.
        text: explanation for people.
    """

    measurement: AttitudeMeasurement
    reason: Reason
    ins_time_ns: int = 0
    residual_v: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    sigma_v: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    nis: float = float("nan")
    gate: float = float("nan")
    text: str = ""
    revised: bool = False

    @property
    def accepted(self) -> bool:
        """True where the measurement entered the estimate."""
        return self.reason is Reason.NONE


@dataclass(frozen=True)
class AttitudeEstimate:
    """The ship's attitude at one moment.

    Attributes:
        time_ns: moment of validity.
        rotation_nd: horizon from deck, shape (3, 3); NaN where no attitude is claimed.
        covariance_parts_n: error covariance by source, rotation vector in the horizon frame, rad²,
            shape (n_sources, 3, 3); the covariance is their sum.
        rate_d: angular velocity in the deck frame, rad/s, shape (3,).
        status: how far it can be relied on.
        horizon: what "up" means.
        sources: what it rests on, for example ``("ins", "star.fore")``.
        star_age_s: time since the last star measurement used; NaN where there was none.
    """

    time_ns: int
    rotation_nd: FloatArray
    covariance_parts_n: FloatArray
    rate_d: FloatArray
    status: Status
    horizon: Horizon
    sources: tuple[str, ...]
    star_age_s: float

    @property
    def covariance_n(self) -> FloatArray:
        """Error covariance, rotation vector in the horizon frame, rad², shape (3, 3)."""
        total: FloatArray = self.covariance_parts_n.sum(axis=0)
        return total
