"""Everything the filter knows after its last measurement.

A :class:`FilterState` is never changed in place, so that the time-ordered log can keep and return to any of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from ship_attitude_star.guards.hints import Departure
from ship_attitude_star.stars.spatial_errors import PixelStay
from ship_attitude_star.vertical.vertical_track import VerticalHere
from ship_estimation import compiled_steps
from ship_estimation.common_error import NOTHING_ABSORBED, Absorbed
from ship_estimation.exclusion import HEARD_NS, Exclusion
from ship_estimation.running_means import Means
from ship_estimation.unconfirmed import Unconfirmed
from ship_geometry.rotations import FloatArray

__all__ = [
    "NO_STAYS",
    "Apart",
    "Doubt",
    "FilterState",
    "Lately",
    "UtcStep",
    "changed",
    "shared_turn",
    "with_entry",
    "without",
]

Value = TypeVar("Value")

if TYPE_CHECKING:
    from dataclasses import replace as changed
else:

    def changed(of, **fields):
        """A frozen dataclass with other values of some fields, as by ``dataclasses.replace``, in a fifth of the time.

        A step changes the state several times. The fields are copied together; none of them is checked or computed when
        such an object is made, and none is kept beside them.
        """
        after = object.__new__(type(of))
        after.__dict__.update(of.__dict__, **fields)
        return after


@dataclass(frozen=True)
class Doubt:
    """What the sources contradict of one another, where nothing tells which of them is wrong.

    Attributes:
        text: for people.
        covariance_n: of an attitude that may be wrong by all that is in dispute, rotation vector in the horizon frame,
            rad², shape (3, 3).
    """

    text: str
    covariance_n: FloatArray


class Apart(NamedTuple):
    """How far a measurement was from what the others made expect.

    Attributes:
        whitened: the turn of the device, of unit covariance, shape (3,).
        root: of its covariance, rad, shape (3, 3).
        predicted_nv: the device as it was expected, horizon from device, shape (3, 3).
    """

    whitened: FloatArray
    root: FloatArray
    predicted_nv: FloatArray

    @property
    def turn_v(self) -> FloatArray:
        """Rotation vector of the device in its own frame, rad, shape (3,)."""
        turn_v: FloatArray = self.root @ self.whitened
        return turn_v

    @property
    def turn_n(self) -> FloatArray:
        """The same in the horizon frame."""
        turn_n: FloatArray = self.predicted_nv @ self.turn_v
        return turn_n


def shared_turn(measured: Sequence[Apart]) -> FloatArray:
    """Return the turn that measurements share, rotation vector in the horizon frame, rad, shape (3,): least squares."""
    whitening = np.vstack([np.linalg.pinv(one.root) @ one.predicted_nv.T for one in measured])
    whitened = np.concatenate([one.whitened for one in measured])
    turn_n: FloatArray = np.linalg.lstsq(whitening, whitened, rcond=None)[0]
    return turn_n


class UtcStep(NamedTuple):
    """A step of the time base that may have made UTC wrong, or right.

    Attributes:
        step_s: sum of the steps since UTC was last compared with the INS's attitude.
        log_ratio: natural logarithm of the likelihood ratio, by the stars since, of the sky being turned by the step to
            its not being turned.
    """

    step_s: float
    log_ratio: float = 0.0


class Lately(NamedTuple):
    """How far the measurements of a source have been from the first row.

    Attributes:
        running: means of them (:attr:`ship_estimation.running_means.Means.running`), shape (w, 5).
        sigmas: how far the mean that is farthest from zero is off, in its own sigmas.
    """

    running: FloatArray
    sigmas: float


NO_STAYS: MappingProxyType[str, PixelStay] = MappingProxyType({})
"""No stars have kept their pixels."""


@dataclass(frozen=True)
class FilterState:
    """The estimate by all sources, in the first of h rows, and beside it those without each of them.

    Attributes:
        time_ns: moment of the state; None before the first measurement.
        means: estimated errors, shape (h, n).
        stack: covariance of the first row by error source, then those of the others, as in
            :mod:`ship_estimation.hypotheses`, shape (n_sources + h - 1, n, n).
        seen: what each row has seen of each source.
        excluded: by source, its exclusion.
        record: by source, how often it was excluded.
        doubt: why the attitude is not to be believed, and by how much; None where it is.
        disputed_n: what an output adds to its covariance while rows stand apart, rad², horizon frame, shape (3, 3); the
            filter's own covariance does not hold it; None for nothing.
        apart: by source, how far its last measurement was from the first row.
        lately: by source, what its measurements that were used have said since the first row was last begun anew.
        heard_since_ns: by source, the stamp since which it has been heard without a long break.
        common_n: by star sensor, the steady covariance of its common error, rad², horizon frame.
        refusals: by source, its refusals in a row.
        used_ns: by source, the stamp of its last measurement used.
        stays: by source, how long its stars have kept their pixels, where that matters; none of before the state was
            opened.
        unconfirmed: a jump of the INS, or what may be one, or a first star measurement, that other stars have not
            confirmed yet; None for none.
        departures: by source, its last measurement refused.
        jumped_ns: the INS's stamp just before its last jump that the state is open for; None where there was none.
        ins_suspected_ns: the last time at which an INS that reported a jump jumped or was contradicted since; None
            where there was none.
        vertical: at the moment of the state; None where no deflection of it is modelled.
        utc: whether UTC is right since the time base stepped; None where that is not in question.
        absorbed: the corrections by all stars of late, and what they may share.
    """

    time_ns: int | None
    means: FloatArray
    stack: FloatArray
    seen: Means
    excluded: MappingProxyType[str, Exclusion] = field(default_factory=lambda: MappingProxyType({}))
    record: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    doubt: Doubt | None = None
    apart: MappingProxyType[str, Apart] = field(default_factory=lambda: MappingProxyType({}))
    lately: MappingProxyType[str, Lately] = field(default_factory=lambda: MappingProxyType({}))
    heard_since_ns: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    common_n: MappingProxyType[str, FloatArray] = field(default_factory=lambda: MappingProxyType({}))
    refusals: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    used_ns: MappingProxyType[str, int] = field(default_factory=lambda: MappingProxyType({}))
    stays: MappingProxyType[str, PixelStay] = field(default_factory=lambda: NO_STAYS)
    unconfirmed: Unconfirmed | None = None
    departures: MappingProxyType[str, Departure] = field(default_factory=lambda: MappingProxyType({}))
    jumped_ns: int | None = None
    ins_suspected_ns: int | None = None
    disputed_n: FloatArray | None = None
    vertical: VerticalHere | None = None
    utc: UtcStep | None = None
    absorbed: Absorbed = NOTHING_ABSORBED

    @property
    def mean(self) -> FloatArray:
        """Estimated errors by all sources that are not excluded, shape (n,)."""
        mean: FloatArray = self.means[0]
        return mean

    @property
    def parts(self) -> FloatArray:
        """Their covariance by error source, shape (n_sources, n, n)."""
        parts: FloatArray = self.stack[: len(self.stack) - len(self.means) + 1]
        return parts

    def has_used(self, source: str) -> bool:
        """True if a measurement of the source was used, although the source may have been excluded since."""
        return source in self.used_ns or source in self.record

    def in_use(self, sources: Sequence[str], time_ns: int) -> list[str]:
        """Those of the sources, in the order of their index, heard of not long ago that are not excluded."""
        heard, since_ns = zip(sources, self.seen.heard_ns.tolist(), strict=True), time_ns - HEARD_NS
        return [name for name, heard_ns in heard if heard_ns >= since_ns and name not in self.excluded]

    @property
    def covariance(self) -> FloatArray:
        """Their covariance, shape (n, n)."""
        total: FloatArray = compiled_steps.total(self.stack, len(self.stack) - len(self.means) + 1)
        return total


def with_entry(mapping: MappingProxyType[str, Value], key: str, value: Value) -> MappingProxyType[str, Value]:
    """The mapping with another value for a key."""
    return MappingProxyType({**mapping, key: value})


def without(mapping: MappingProxyType[str, Value], key: str) -> MappingProxyType[str, Value]:
    """The mapping without a key."""
    return MappingProxyType({name: value for name, value in mapping.items() if name != key})
