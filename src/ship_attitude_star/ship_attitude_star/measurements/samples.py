"""What goes into the ship-attitude core and what comes out: plain structs in radians, metres and nanoseconds."""

import enum
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ship_estimation.refusals import Reason, Refusal
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
        shared_n: turn of the sky, as the horizon has it, by one sigma of each error that all star sensors share
            (:data:`ship_attitude_star.sky.apparent_sky.SHARED_TERMS`), rad, shape (3, 4); None where the message knows
            of none.
    """

    source: str
    time_ns: int
    rotation_nv: FloatArray
    noise_v: FloatArray
    common_n: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    covariance_known: bool = True
    shared_n: FloatArray | None = None

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        return self.rotation_nv.tobytes() + self.noise_v.tobytes() + self.common_n.tobytes()


class Measurement(Protocol):
    """What every kind of measurement has: its source, its stamp, and bytes to tell it from another of its stamp."""

    @property
    def source(self) -> str:
        """``star.<id>`` or ``reference.<name>``."""
        ...

    @property
    def time_ns(self) -> int:
        """Stamp of the device."""
        ...

    @property
    def covariance_known(self) -> bool:
        """False where the message gave none and the configured sigma stands in."""
        ...

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        ...


ATTITUDE_COMPONENTS = ("forward", "up", "right")
"""Of the residual of an attitude: rotation vector in the device frame."""


@dataclass(frozen=True)
class Decision:
    """What became of a measurement.

    Attributes:
        measurement: the measurement itself.
        ins_time_ns: the stamp of the INS to which it was compared.
        residual: measured minus predicted, rad; empty where it was not compared at all.
        sigma: predicted standard deviation of each component of the residual, rad.
        components: names of them: ATTITUDE_COMPONENTS, or "HIP 92420 up" and "HIP 92420 right" for each star used.
        nis: normalised innovation squared, chi² with as many degrees of freedom.
        gate: the value that ``nis`` must not exceed.
        reason: why it was not used; NONE where it was.
        revised: True where a measurement that arrived late changed an earlier decision.
        text: explanation for people.
        stars_refused: of an exposure, the stars that had no part in it, by name.
    """

    measurement: Measurement
    reason: Reason
    ins_time_ns: int = 0
    residual: FloatArray = field(default_factory=lambda: np.empty(0))
    sigma: FloatArray = field(default_factory=lambda: np.empty(0))
    components: tuple[str, ...] = ()
    nis: float = float("nan")
    gate: float = float("nan")
    text: str = ""
    revised: bool = False
    stars_refused: tuple[tuple[str, Refusal], ...] = ()

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


@dataclass
class Outcome:
    """What one input led to.

    Attributes:
        refusal: why this very input was not used; None where it was, or still waits.
        decisions: measurements judged now, this one or others that had waited for it.
        estimates: attitudes to publish; times increase strictly from claim to claim, see
            :class:`ship_estimation.output_order.OutputOrder`.
        failures: by stamp, attitudes that could not be computed: the software itself failed.
    """

    refusal: Refusal | None = None
    decisions: list[Decision] = field(default_factory=list)
    estimates: list[AttitudeEstimate] = field(default_factory=list)
    failures: list[tuple[int, Refusal]] = field(default_factory=list)
