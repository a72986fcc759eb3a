"""What goes into the ship-attitude core and what comes out: plain structs in radians, metres and nanoseconds."""

import enum
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_estimation.outcome import Decision, Measurement, Outcome, Status
from ship_geometry.rotations import FloatArray

StampArray = NDArray[np.int64]
"""Stamps, ns."""


class Horizon(enum.IntEnum):
    """What "up" means: the ellipsoid normal by the stars, or the local gravity by the INS alone."""

    GEODETIC = 0
    GRAVITY = 1


SHARED_BY_SKY = "sky"
"""Names errors that all sensors share which look at the same sky: those of refraction, UT1 and position."""

SHARED_BY_MESSAGES = "message"
"""Names the error that several messages have in common, of which nothing is known but its size."""

SHARED_BY_GRAVITY = "gravity"
"""Names the deflection of the vertical, by which all systems that level themselves differ from the geodetic horizon."""


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
        shared_n: turn of the sky, as the horizon has it, by one sigma of each error that star sensors share, rad, shape
            (3, n); None where the message knows of none.
        shared_by: which errors these are: SHARED_BY_SKY, n = 4
            (:data:`ship_attitude_star.sky.sky_watch.SHARED_TERMS`), SHARED_BY_MESSAGES, n = 3, or SHARED_BY_GRAVITY,
            n = 2, of which the unit is the radian.
    """

    source: str
    time_ns: int
    rotation_nv: FloatArray
    noise_v: FloatArray
    common_n: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    covariance_known: bool = True
    shared_n: FloatArray | None = None
    shared_by: str = SHARED_BY_SKY
    reach_ns = 0  # an attitude is that of its moment

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        shared = b"" if self.shared_n is None else self.shared_n.tobytes()
        return self.rotation_nv.tobytes() + self.noise_v.tobytes() + self.common_n.tobytes() + shared

    @property
    def lasting_n(self) -> FloatArray:
        """Covariance of all that is not independent from epoch to epoch, shared or not, horizon frame, rad², (3, 3)."""
        return self.common_n if self.shared_n is None else self.common_n + self.shared_n @ self.shared_n.T


@dataclass(frozen=True)
class SolvedAttitude(AttitudeMeasurement):
    """The attitude of a sensor that placed its stars by the ship's own fix, UT1 and air, before these are told apart.

    What it shares with others is part of ``common_n``, or of ``noise_v`` where the message does not tell the two apart.

    Attributes:
        noise_told: False where the message has one covariance for all.
    """

    noise_told: bool = True


ATTITUDE_COMPONENTS = ("forward", "up", "right")
"""Of the residual of an attitude: rotation vector in the device frame."""


@dataclass(frozen=True)
class AttitudeDecision(Decision[Measurement]):
    """What became of a measurement that was to be compared with the INS.

    ``components`` are ATTITUDE_COMPONENTS, or "HIP 92420 up" and "HIP 92420 right" for each star used.

    Attributes:
        ins_time_ns: the stamp of the INS to which it was compared.
    """

    ins_time_ns: int = 0


@dataclass(frozen=True)
class AttitudeEstimate:
    """The ship's attitude at one moment.

    Attributes:
        time_ns: moment of validity.
        rotation_nd: horizon from deck, shape (3, 3); NaN where no attitude is claimed.
        covariance_parts_n: error covariance by source, rotation vector in the horizon frame, rad²,
            shape (n_sources, 3, 3).
        covariance_n: error covariance: the sum of the parts, shape (3, 3).
        undisputed_n: the same without what the sources dispute: the protection levels rest on it.
        rate_d: angular velocity in the deck frame, rad/s, shape (3,).
        status: how far it can be relied on.
        horizon: what "up" means.
        sources: what it rests on, for example ``("ins", "star.fore")``.
        star_age_s: time since the last star measurement used; NaN where there was none.
        state: of the filter, that it rests on.
        text: why it is DEGRADED, for people; otherwise empty.
    """

    time_ns: int
    rotation_nd: FloatArray
    covariance_parts_n: FloatArray
    covariance_n: FloatArray
    undisputed_n: FloatArray
    rate_d: FloatArray
    status: Status
    horizon: Horizon
    sources: tuple[str, ...]
    star_age_s: float
    state: Any = field(repr=False)
    text: str = ""


@dataclass(frozen=True)
class AttitudeRun:
    """The ship's attitudes at N moments that rest on one state; each field is that of :class:`AttitudeEstimate`.

    Attributes:
        time_ns: in ascending order, shape (N,).
        rotation_nd: shape (N, 3, 3).
        covariance_parts_n: shape (N, n_sources, 3, 3).
        covariance_n: shape (N, 3, 3).
        undisputed_n: shape (N, 3, 3).
        rate_d: shape (N, 3).
        status: N of them.
        horizon: shape (N,).
        sources: N of them.
        star_age_s: shape (N,).
        state: of the filter.
        text: N of them.
    """

    time_ns: StampArray
    rotation_nd: FloatArray
    covariance_parts_n: FloatArray
    covariance_n: FloatArray
    undisputed_n: FloatArray
    rate_d: FloatArray
    status: list[Status]
    horizon: NDArray[np.int64]
    sources: list[tuple[str, ...]]
    star_age_s: FloatArray
    state: Any = field(repr=False)
    text: list[str]

    @classmethod
    def of_one(cls, estimate: AttitudeEstimate) -> "AttitudeRun":
        """The run of one attitude."""
        return cls(
            time_ns=np.array([estimate.time_ns]),
            rotation_nd=estimate.rotation_nd[None],
            covariance_parts_n=estimate.covariance_parts_n[None],
            covariance_n=estimate.covariance_n[None],
            undisputed_n=estimate.undisputed_n[None],
            rate_d=estimate.rate_d[None],
            status=[estimate.status],
            horizon=np.array([estimate.horizon]),
            sources=[estimate.sources],
            star_age_s=np.array([estimate.star_age_s]),
            state=estimate.state,
            text=[estimate.text],
        )

    def some(self, which: slice) -> "AttitudeRun":
        """Some of them."""
        return AttitudeRun(
            time_ns=self.time_ns[which],
            rotation_nd=self.rotation_nd[which],
            covariance_parts_n=self.covariance_parts_n[which],
            covariance_n=self.covariance_n[which],
            undisputed_n=self.undisputed_n[which],
            rate_d=self.rate_d[which],
            status=self.status[which],
            horizon=self.horizon[which],
            sources=self.sources[which],
            star_age_s=self.star_age_s[which],
            state=self.state,
            text=self.text[which],
        )

    def one(self, number: int) -> AttitudeEstimate:
        """One of them."""
        return AttitudeEstimate(
            time_ns=int(self.time_ns[number]),
            rotation_nd=self.rotation_nd[number],
            covariance_parts_n=self.covariance_parts_n[number],
            covariance_n=self.covariance_n[number],
            undisputed_n=self.undisputed_n[number],
            rate_d=self.rate_d[number],
            status=self.status[number],
            horizon=Horizon(self.horizon[number]),
            sources=self.sources[number],
            star_age_s=float(self.star_age_s[number]),
            state=self.state,
            text=self.text[number],
        )


AttitudeOutcome = Outcome[AttitudeDecision, AttitudeEstimate]
"""What one input led to."""

