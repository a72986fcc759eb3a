"""Output messages of several nodes, and the values for the fields of output messages.

Several nodes publish innovations, error budgets, integrity and diagnostics. The values for the fields of a node's own
messages are numbers for one output and columns for many outputs. The assignment of values to fields is therefore
defined once per node.
"""

import enum
import struct
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_bags.cdr_template import HEADER, CdrMessage
from ship_bags.message_factory import MessageFactory, cdr_text
from ship_bags.stamps import NS_PER_S
from ship_estimation.integrity.protection_levels import IntegrityConfig, IntegrityReport, IntegrityState
from ship_estimation.rejection_rules import Reason, Rejection, shorten
from ship_estimation.time_order.outcome import MeasurementDecision
from ship_geometry.frames import enu_covariance
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.messages.inputs_outputs import OutputRows

DIAGNOSTICS_TOPIC = "/diagnostics"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
INNOVATION_TYPE = "ship_msgs/msg/Innovation"
BUDGET_TYPE = "ship_msgs/msg/ErrorBudget"
INTEGRITY_TYPE = "ship_msgs/msg/Integrity"
TF_TOPIC, TF_STATIC_TOPIC, TF_TYPE = "/tf", "/tf_static", "tf2_msgs/msg/TFMessage"
ZERO_VECTOR = dict.fromkeys("xyz", 0.0)
"""Fields of a geometry_msgs/Vector3 that is unknown or not given: position of a frame, acceleration."""

_NOTHING = np.empty(0)
_count = struct.Struct("<I").pack

Fields = Mapping[str, Any]
MessageFields = list[tuple[str, str, Fields]]
"""Topic, type and fields of each message."""


class Level(enum.IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class DiagnosticStatus:
    """State of one part of a node.

    Attributes:
        name: name of the part, as ``"input ins/imu"``.
        level: severity.
        message: one line for the user.
        values: further values as texts, by name.
    """

    name: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


class _ReportedStatus(NamedTuple):
    """Status with the fields of an entry of diagnostic_msgs/DiagnosticArray."""

    status: DiagnosticStatus
    name: str
    hardware_id: str

    @property
    def level(self) -> int:
        return int(self.status.level)

    @property
    def message(self) -> str:
        return self.status.message

    @property
    def values(self) -> list[SimpleNamespace]:
        return [SimpleNamespace(key=key, value=value) for key, value in self.status.values.items()]


def diagnostic_array(
    now_ns: int, node: str, statuses: Iterable[DiagnosticStatus], full_name: str = ""
) -> CdrMessage:
    """Return an encoded diagnostic_msgs/DiagnosticArray.

    No template is used, because the texts change from one array to the next. All fields except the levels are texts and
    counts, aligned to four bytes, so that their bytes are concatenated.

    Args:
        now_ns: time of the report.
        node: name of the node; each status is named ``"<node>: <name>"``.
        statuses: the statuses.
        full_name: the node's name with its namespace, used as hardware_id; if empty, ``node`` is used.
    """
    stamp, hardware_id = divmod(now_ns, NS_PER_S), full_name or node
    reported = [_ReportedStatus(status, f"{node}: {status.name}", hardware_id) for status in statuses]
    data = bytearray(b"".join([HEADER, struct.pack("<iI", *stamp), cdr_text(""), _count(len(reported))]))
    end = len(data)
    for status, name, _ in reported:
        # The level, one byte, follows the last text directly, without padding.
        data[end:] = bytes([status.level])
        data += bytes(-len(data) % 4)
        parts = [cdr_text(name), cdr_text(status.message), cdr_text(hardware_id), _count(len(status.values))]
        for key, value in status.values.items():
            parts += cdr_text(key), cdr_text(value)
        data += b"".join(parts)
        end = len(data) - (3 - len(value.encode()) % 4 if status.values else 0)
    del data[end:]
    header = SimpleNamespace(stamp=SimpleNamespace(sec=stamp[0], nanosec=stamp[1]), frame_id="")
    return CdrMessage(DIAGNOSTICS_TYPE, bytes(data), {"header": lambda _: header, "status": lambda _: reported})


def decision_message(factory: MessageFactory, source: str, decision: MeasurementDecision[Any]) -> Any:
    """Return the ship_msgs/Innovation of a decision, first or revised, on a measurement.

    Args:
        factory: makes the message.
        source: name of the source.
        decision: decision on the measurement.
    """
    reason, text = decision.reason, decision.text
    if decision.accepted and not decision.measurement.covariance_known:
        reason, text = Reason.COVARIANCE_UNKNOWN, "the message gives no covariance: used with the configured sigma"
    if decision.revised:
        result = "now accepted" if decision.accepted else f"now rejected: {reason.word}"
        reason, text = Reason.REVISED, f"re-evaluated after a late measurement, {result} {text}".rstrip()
    # Layouts are cached; a text with numbers would need a new layout each time.
    make = factory.make if text else factory.encode
    return make(
        INNOVATION_TYPE,
        header={"stamp": decision.measurement.time_ns, "frame_id": source},
        source=source,
        components=list(decision.components),
        residual=decision.residual,
        sigma=decision.sigma,
        nis=float(decision.nis),
        gate=float(decision.gate),
        accepted=decision.accepted,
        reason=int(reason),
        reason_text=text,
    )


def rejection_message(
    factory: MessageFactory,
    source: str,
    time_ns: int,
    rejection: Rejection,
    components: Sequence[str] = (),
    residual: FloatArray = _NOTHING,
    sigma: FloatArray = _NOTHING,
    nis: float = float("nan"),
) -> Any:
    """Return the ship_msgs/Innovation of a rejected input, or of a rejected part of an input (a star, a light).

    Args:
        factory: makes the message.
        source: name of the source.
        time_ns: stamp of the input.
        rejection: the reason.
        components: names of the residuals; empty if nothing was compared.
        residual: measured minus predicted, rad, shape (m,).
        sigma: predicted standard deviation of each residual, rad, shape (m,).
        nis: normalised innovation squared.
    """
    source = shorten(source)
    return factory.make(
        INNOVATION_TYPE,
        header={"stamp": time_ns, "frame_id": source},
        source=source,
        components=list(components),
        residual=residual,
        sigma=sigma,
        nis=nis,
        gate=float("nan"),
        accepted=False,
        reason=int(rejection.reason),
        reason_text=rejection.text,
    )


def error_budget_message(
    factory: MessageFactory,
    quantity: str,
    time_ns: int,
    frame_id: str,
    sources: Sequence[str],
    covariances_n: FloatArray,
    covariance_n: FloatArray,
) -> Any:
    """Return the ship_msgs/ErrorBudget of an estimate: its covariance by error source.

    Args:
        factory: makes the message.
        quantity: the estimated quantity.
        time_ns: stamp of the estimate.
        frame_id: frame whose attitude is estimated.
        sources: names of the error sources.
        covariances_n: covariance due to each source, as rotation vector in (North, Up, East), rad², shape (n_sources,
            3, 3).
        covariance_n: sum of ``covariances_n``, rad², shape (3, 3).
    """
    return factory.encode(
        BUDGET_TYPE,
        header={"stamp": time_ns, "frame_id": frame_id},
        quantity=quantity,
        sources=list(sources),
        covariances=enu_covariance(covariances_n).ravel(),
        total=enu_covariance(covariance_n).ravel(),
    )


def integrity_message(
    factory: MessageFactory, report: IntegrityReport, quantities: Sequence[str], frame_id: str, config: IntegrityConfig
) -> Any:
    """Return the ship_msgs/Integrity of an output.

    Args:
        factory: makes the message.
        report: protection levels, test statistics and excluded sources.
        quantities: names of the bounded components.
        frame_id: frame of the output.
        config: alert limits and probability.
    """
    return factory.encode(
        INTEGRITY_TYPE,
        header={"stamp": report.time_ns, "frame_id": frame_id},
        quantities=list(quantities),
        protection_level=report.level,
        alert_limit=config.alert_limit,
        p_hmi_per_h=config.p_hmi,
        state=int(report.state),
        hypotheses=list(report.hypotheses),
        statistic=report.statistic,
        threshold=[report.threshold] * len(report.hypotheses),
        excluded=[name for name, _ in report.excluded],
        excluded_for_s=[(report.time_ns - since_ns) * 1e-9 for _, since_ns in report.excluded],
        dominant=report.dominant,
    )


def integrity_status(report: IntegrityReport | None, quantities: Sequence[str]) -> DiagnosticStatus:
    """Return the status with the protection levels of the last output; ``report`` is None if no output is valid."""
    if report is None:
        return DiagnosticStatus("integrity", Level.OK, "no output yet")
    levels = {f"{name} (″)": f"{level / ARCSEC:.1f}" for name, level in zip(quantities, report.level, strict=True)}
    values = {**levels, "dominant hypothesis": report.dominant or "no fault"}
    if report.excluded:
        seconds = [f"{name} for {(report.time_ns - since_ns) * 1e-9:.0f} s" for name, since_ns in report.excluded]
        return DiagnosticStatus("integrity", Level.WARN, f"excluded: {', '.join(seconds)}", values)
    why = "too few redundant sources, contradicting sources, or an unconfirmed jump"
    words = {
        IntegrityState.MET: (Level.OK, "every protection level is within its alert limit"),
        IntegrityState.EXCEEDED: (Level.WARN, "a protection level is above its alert limit"),
        IntegrityState.UNAVAILABLE: (Level.OK, f"no protection level: {why}"),
        IntegrityState.NO_LIMIT: (Level.OK, "no alert limit is configured"),
    }
    return DiagnosticStatus("integrity", *words[report.state], values)


def join_fields(runs: Sequence[Any], names: Iterable[str]) -> list[Any]:
    """Return each named field, concatenated over several runs of outputs to one array or list.

    Example:
        >>> from types import SimpleNamespace
        >>> runs = [SimpleNamespace(text=["a"], angle=np.zeros(1)), SimpleNamespace(text=["b"], angle=np.ones(2))]
        >>> join_fields(runs, ["text", "angle"])
        [['a', 'b'], array([0., 1., 1.])]
    """
    if len(runs) == 1:
        return [getattr(runs[0], name) for name in names]
    columns = [[getattr(run, name) for run in runs] for name in names]
    return [list(chain(*values)) if isinstance(values[0], list) else np.concatenate(values) for values in columns]


def select_values(values: Any, places: NDArray[np.int64]) -> Any:
    """Return the values of an array or a list at some indices."""
    return [values[place] for place in places] if isinstance(values, list) else values[places]


def rows_by_kind(
    factory: MessageFactory,
    kinds: Iterable[Hashable],
    messages_of: Callable[[Any, NDArray[np.int64]], MessageFields],
) -> Iterator[OutputRows]:
    """Return the messages of many outputs; the messages of one output are in the order of ``messages_of``.

    Args:
        factory: makes the messages.
        kinds: kind of each output; outputs of one kind have messages with the same texts and array lengths.
        messages_of: returns the messages for a kind and the indices of its outputs.
    """
    kinds = list(kinds)
    for kind in dict.fromkeys(kinds):
        places = np.array([place for place, other in enumerate(kinds) if other == kind])
        for topic, type_name, fields in messages_of(kind, places):
            yield OutputRows(topic, factory.encode_rows(type_name, len(places), **fields), places)
