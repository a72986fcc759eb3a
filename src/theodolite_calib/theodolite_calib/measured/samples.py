"""What goes into the optical-axis core and what comes out: plain structs in radians, metres and nanoseconds."""

import enum
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ship_estimation.refusals import Reason, Refusal
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.exposure_mean import Nodes, exposure_nodes
from ship_geometry.rotations import FloatArray
from ship_geometry.vector_track import VectorSample


class Mode(enum.IntEnum):
    """How the pointing was found; the values are those of ship_msgs/OpticalAxisPointing."""

    TWO_LIGHTS = 0
    ONE_LIGHT = 1
    ENCODER = 2


class Status(enum.IntEnum):
    """What a pointing, or the ship's attitude, is worth; the values are those of the messages."""

    VALID = 0
    COASTING = 1
    DEGRADED = 2
    INVALID = 3


@dataclass(frozen=True)
class EncoderSample(VectorSample):
    """One reading of both encoders: ``vector`` is (azimuth, elevation), rad.

    Attributes:
        sigma: noise of each reading, rad.
    """

    sigma: float

    def content(self) -> bytes:
        """See :meth:`VectorSample.content`."""
        return super().content() + np.float64(self.sigma).tobytes()


@dataclass(frozen=True)
class ShipSample(AttitudeSample):
    """The ship's attitude at one moment.

    Attributes:
        slow_covariance_n: of the part of its error that lasts, rotation vector in n, rad², shape (3, 3); None where
            the configuration says what it is.
        status: what the source says that it is worth.
    """

    slow_covariance_n: FloatArray | None = None
    status: Status = Status.VALID

    def content(self) -> bytes:
        """See :meth:`AttitudeSample.content`."""
        covariance = b"" if self.slow_covariance_n is None else self.slow_covariance_n.tobytes()
        return super().content() + covariance + bytes([self.status])


@dataclass(frozen=True)
class BaselineSample(VectorSample):
    """One baseline from the ship's antenna to a drone's: ``vector`` is in (North, Up, East), m.

    Attributes:
        covariance_n: of what is new in it, m², shape (3, 3).
        refusal: why it must not be used; the moment is known not to have a better one.
    """

    covariance_n: FloatArray
    refusal: Refusal | None = None

    def content(self) -> bytes:
        """See :meth:`VectorSample.content`."""
        return super().content() + self.covariance_n.tobytes() + repr(self.refusal).encode()


@dataclass(frozen=True)
class SeenLight:
    """A light on the detector.

    Attributes:
        beacon_id: its name.
        point_m: (x right, z up), shape (2,).
        sigma_m: standard deviation of x and of z.
    """

    beacon_id: str
    point_m: FloatArray
    sigma_m: float


@dataclass(frozen=True)
class Exposure:
    """One image of the calibration telescope.

    Attributes:
        time_ns: middle of the exposure.
        lights: in the order of their names, each name once.
        exposure_s: how long it lasted; 0 where nobody said so.
    """

    time_ns: int
    lights: tuple[SeenLight, ...]
    exposure_s: float = 0.0

    @cached_property
    def nodes(self) -> Nodes | None:
        """Moments by which the mean over it is found; None where its length is not known."""
        return exposure_nodes(self.exposure_s) if self.exposure_s > 0.0 else None

    @property
    def reach_ns(self) -> int:
        """How far from the middle it must be known how telescope and ship turned."""
        return 0 if self.nodes is None else self.nodes.reach_ns

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        lights = b"".join(
            light.beacon_id.encode() + light.point_m.tobytes() + np.float64(light.sigma_m).tobytes()
            for light in self.lights
        )
        return lights + np.float64(self.exposure_s).tobytes()


@dataclass(frozen=True)
class Decision:
    """What became of an exposure.

    Attributes:
        exposure: itself.
        reason: why it was not used; NONE where it was; LIGHT_CONFLICT where it was with names exchanged.
        accepted: True where it entered the estimate.
        components: names of the residuals.
        residual: measured minus predicted, on the sky, rad.
        sigma: predicted standard deviation of each, rad.
        nis: normalised innovation squared.
        gate: the value that ``nis`` must not exceed.
        text: explanation for people.
        lights_refused: lights that had no part in it, by name.
        telescope_dt: deck from telescope as the lights have it, shape (3, 3), and the standard deviation about its
            worst axis, rad; None where they do not tell.
        revised: True where a measurement that arrived late changed an earlier decision.
    """

    exposure: Exposure
    reason: Reason
    accepted: bool = False
    components: tuple[str, ...] = ()
    residual: FloatArray = field(default_factory=lambda: np.empty(0))
    sigma: FloatArray = field(default_factory=lambda: np.empty(0))
    nis: float = float("nan")
    gate: float = float("nan")
    text: str = ""
    lights_refused: tuple[tuple[str, Refusal], ...] = ()
    telescope_dt: tuple[FloatArray, float] | None = None
    revised: bool = False


@dataclass(frozen=True)
class PointingEstimate:
    """Where the main axis points at one moment; NaN where no pointing is claimed.

    Attributes:
        time_ns: moment of validity.
        rotation_nm: horizon from main frame, shape (3, 3).
        parts_n: error covariance by source, rotation vector in n, rad², shape (n_sources, 3, 3).
        rotation_nt: horizon from telescope, shape (3, 3); NaN in mode ENCODER.
        mode: how it was found.
        status: what it is worth.
        light_count: lights used.
        text: why it is not VALID.
    """

    time_ns: int
    rotation_nm: FloatArray
    parts_n: FloatArray
    rotation_nt: FloatArray
    mode: Mode
    status: Status
    light_count: int
    text: str = ""

    @property
    def covariance_n(self) -> FloatArray:
        """Error covariance, rotation vector in n, rad², shape (3, 3)."""
        total: FloatArray = self.parts_n.sum(axis=0)
        return total


@dataclass
class Outcome:
    """What one input led to.

    Attributes:
        refusal: why this very input was not used; None where it was, or still waits.
        decisions: exposures judged now.
        estimates: pointings to publish; times increase strictly from claim to claim, see
            :class:`ship_estimation.estimator_shell.OutputOrder`.
        failures: by stamp, pointings that could not be computed: the software itself failed.
    """

    refusal: Refusal | None = None
    decisions: list[Decision] = field(default_factory=list)
    estimates: list[PointingEstimate] = field(default_factory=list)
    failures: list[tuple[int, Refusal]] = field(default_factory=list)
