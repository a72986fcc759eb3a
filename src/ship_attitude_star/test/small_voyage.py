"""A small ship for the tests of the adapter: it rolls and pitches under an INS at 25 Hz and two star sensors at 5 Hz.

Everything is computed from formulas and one seed, so that two runs differ only where their messages do.
"""

import copy
import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ship_attitude_star.adapter import ShipAttitudeAdapter
from ship_attitude_star.config import ShipAttitudeConfig
from ship_estimation.parameters import build
from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.ros_axes import enu_covariance, flu_from_device_vector, quaternion_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_node.message_factory import RosidlFactory
from ship_node.stamps import make_header, ns_from_stamp
from ship_node.tick_grid import TickGrid

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
INS = "ins/imu"
FORE = "star/fore/horizon_attitude"
STARBOARD = "star/starboard/horizon_attitude"
FACTORY = RosidlFactory()

_INS_PERIOD_NS, _INS_LATENCY_NS = 40_000_000, 5_000_000
_STAR_PERIOD_NS, _STAR_LATENCY_NS = 200_000_000, 120_000_000
_STAR_PHASE_NS = {FORE: 13_000_000, STARBOARD: 77_000_000}
_STAR_AZIMUTH_DEG = {FORE: 0.0, STARBOARD: 90.0}
_INS_ERROR_N = np.array([10.0, 60.0, -8.0]) * ARCSEC
_TAU_S = 0.003
_STAR_NOISE_V = np.diag((np.array([100.0, 3.0, 3.0]) * ARCSEC) ** 2)
_JUDGEMENTS = ("ship/innovation", "input_health", "/diagnostics")


@dataclass(frozen=True)
class Arrival:
    """A message on its way into the adapter."""

    topic: str
    message: Any
    receive_ns: int

    @property
    def stamp_ns(self) -> int:
        return stamp_of(self.message)


@dataclass
class Run:
    """What an adapter made of some arrivals: (time of publishing, topic, message)."""

    adapter: ShipAttitudeAdapter
    published: list[tuple[int, str, Any]] = field(default_factory=list)
    now_ns: int = 0

    def messages(self, topic: str) -> list[Any]:
        return [message for _, name, message in self.published if name == topic]

    def results(self) -> list[tuple[int, str, Any]]:
        """All that is published of the ship, to the last bit; without the judgements on the inputs."""
        return [(ns, topic, exactly(message)) for ns, topic, message in self.published if topic not in _JUDGEMENTS]

    def state(self) -> tuple[Any, ...]:
        """The filter's state to the last bit; the count of refusals aside."""
        state = self.adapter.core.state
        common = {name: matrix.tobytes() for name, matrix in state.common_n.items()}
        return state.time_ns, state.mean.tobytes(), state.parts.tobytes(), common, dict(state.used_ns)

    def reasons(self, topic: str) -> dict[str, int]:
        health = self.health(topic)
        return dict(zip(health.reasons, health.reason_counts, strict=True))

    def health(self, topic: str) -> Any:
        return next(m for m in self.adapter.health.messages(FACTORY, self.now_ns) if m.topic == topic)

    def innovations(self, reason: int) -> list[Any]:
        return [m for m in self.messages("ship/innovation") if m.reason == reason]

    def diagnostics(self, name: str, since_ns: int, until_ns: int) -> list[tuple[int, str]]:
        """(level, text) of one status in all reports of a time."""
        return [
            (status.level[0], status.message)
            for ns, topic, report in self.published
            if topic == "/diagnostics" and since_ns <= ns <= until_ns
            for status in report.status
            if status.name == f"ship_attitude: {name}"
        ]


def exactly(value: Any) -> Any:
    """A message as tuples of bytes and texts: NaN equals NaN, and 0.0 is not -0.0."""
    if hasattr(value, "get_fields_and_field_types"):
        return tuple(exactly(getattr(value, name)) for name in value.get_fields_and_field_types())
    return value if isinstance(value, str) else np.asarray(value).tobytes()


def config(**changes: Any) -> ShipAttitudeConfig:
    """The configuration that fits the voyage, with dotted parameters changed (``__`` for the dot)."""
    star = {"elevation_deg": 45.0}
    values: dict[str, Any] = {
        "ins": {"frame_id": "ins"},
        "star_sensors": {
            "fore": {**star, "azimuth_deg": 0.0, "frame_id": "star_fore", "serial": "F1"},
            "starboard": {**star, "azimuth_deg": 90.0, "frame_id": "star_starboard", "serial": "S1"},
        },
    }
    for dotted, value in changes.items():
        *groups, leaf = dotted.split("__")
        group = values
        for name in groups:
            group = group.setdefault(name, {})
        group[leaf] = value
    return build(ShipAttitudeConfig, values)


def new_adapter(**changes: Any) -> ShipAttitudeAdapter:
    return ShipAttitudeAdapter(config(**changes), FACTORY)


def attitude(t_s: float, heading_deg: float) -> FloatArray:
    """Horizon from deck: swell of 0.5° in heading, 2° in pitch, 4° in roll."""
    swing = np.sin(2.0 * np.pi * t_s / np.array([30.0, 8.0, 11.0]) + np.array([0.0, 0.0, 0.3]))
    return rotation_from_angles(*np.deg2rad(np.array([heading_deg, 0.0, 0.0]) + np.array([0.5, 2.0, 4.0]) * swing))


@functools.cache
def voyage(duration_s: float = 5.0, heading_deg: float = 34.4) -> tuple[Arrival, ...]:
    """All arrivals in the order in which they come. Change only copies of them."""
    rng = np.random.default_rng(20240101)
    arrivals = []
    for since_ns in range(0, round(duration_s * SECOND_NS), _INS_PERIOD_NS):
        message = ins_message(since_ns, heading_deg, ARCSEC * rng.standard_normal(3))
        arrivals.append(Arrival(INS, message, START_NS + since_ns + _INS_LATENCY_NS))
    for topic, phase_ns in _STAR_PHASE_NS.items():
        for since_ns in range(phase_ns, round(duration_s * SECOND_NS), _STAR_PERIOD_NS):
            noise = np.sqrt(np.diagonal(_STAR_NOISE_V)) * rng.standard_normal(3)
            message = star_message(topic, since_ns, heading_deg, noise)
            arrivals.append(Arrival(topic, message, START_NS + since_ns + _STAR_LATENCY_NS))
    return in_order(arrivals)


def ins_message(since_ns: int, heading_deg: float, white_n: FloatArray) -> Any:
    """What the INS says: true = exp(a) exp(w) measured, valid at its stamp + tau."""
    t_s = since_ns * 1e-9 + _TAU_S
    before, after = attitude(t_s - 1e-4, heading_deg), attitude(t_s + 1e-4, heading_deg)
    rotation_nd = exp_rotation(-white_n) @ exp_rotation(-_INS_ERROR_N) @ attitude(t_s, heading_deg)
    return FACTORY.make(
        "sensor_msgs/msg/Imu",
        header=make_header(FACTORY, START_NS + since_ns, "ins"),
        orientation=quaternion_message(rotation_nd),
        orientation_covariance=np.diag((np.array([10.0, 10.0, 72.0]) * ARCSEC) ** 2).ravel(),
        angular_velocity=vector_message(flu_from_device_vector(log_rotation(before.T @ after) / 2e-4)),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector_message(np.zeros(3)),
        linear_acceleration_covariance=np.zeros(9),
    )


def star_message(topic: str, since_ns: int, heading_deg: float, noise_v: FloatArray) -> Any:
    """What a star sensor says of its own attitude."""
    sensor = topic.split("/")[1]
    rotation_dv = rotation_from_angles(*np.deg2rad([_STAR_AZIMUTH_DEG[topic], 45.0, 0.0]))
    rotation_nv = attitude(since_ns * 1e-9, heading_deg) @ rotation_dv @ exp_rotation(noise_v)
    azimuth, elevation, roll = angles_from_rotation(rotation_nv).tolist()
    return FACTORY.make(
        "ship_msgs/msg/StarHorizonAttitude",
        header=make_header(FACTORY, START_NS + since_ns, f"star_{sensor}"),
        sensor_id=sensor,
        azimuth=azimuth,
        elevation=elevation,
        roll=roll,
        covariance=np.zeros(9),
        rotation_covariance=enu_covariance(rotation_nv @ _STAR_NOISE_V @ rotation_nv.T).ravel(),
        noise_covariance=np.zeros(9),
        star_count=12,
        rejected_count=0,
        residual_rms=2.0 * ARCSEC,
        status=0,
    )


def quaternion_message(rotation_nd: FloatArray) -> Any:
    x, y, z, w = quaternion_from_rotation(rotation_nd).tolist()
    return FACTORY.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def vector_message(vector: FloatArray) -> Any:
    x, y, z = vector.tolist()
    return FACTORY.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def in_order(arrivals: Iterable[Arrival]) -> tuple[Arrival, ...]:
    return tuple(sorted(arrivals, key=lambda arrival: arrival.receive_ns))


def stamp_of(message: Any) -> int:
    return ns_from_stamp(message.header.stamp)


def index_at(arrivals: tuple[Arrival, ...], topic: str, since_s: float) -> int:
    """The first arrival of a topic that was stamped this long after the start."""
    limit_ns = START_NS + round(since_s * SECOND_NS)
    return next(i for i, a in enumerate(arrivals) if a.topic == topic and a.stamp_ns >= limit_ns)


def without(arrivals: tuple[Arrival, ...], index: int) -> tuple[Arrival, ...]:
    return (*arrivals[:index], *arrivals[index + 1 :])


def replaced(
    arrivals: tuple[Arrival, ...], index: int, change: Callable[[Any], None], receive_ns: int | None = None
) -> tuple[Arrival, ...]:
    """One message changed in place, at another time of arrival if given."""
    return in_order((*without(arrivals, index), changed_copy(arrivals[index], change, receive_ns)))


def added(
    arrivals: tuple[Arrival, ...], index: int, change: Callable[[Any], None], receive_ns: int
) -> tuple[Arrival, ...]:
    """A changed copy of one message arrives too."""
    return in_order((*arrivals, changed_copy(arrivals[index], change, receive_ns)))


def changed_copy(arrival: Arrival, change: Callable[[Any], None], receive_ns: int | None = None) -> Arrival:
    message = copy.deepcopy(arrival.message)
    change(message)
    return replace(arrival, message=message, receive_ns=arrival.receive_ns if receive_ns is None else receive_ns)


def changed_where(
    arrivals: Iterable[Arrival], chosen: Callable[[Arrival], bool], change: Callable[[Any], None]
) -> tuple[Arrival, ...]:
    """All chosen messages changed."""
    return tuple(changed_copy(a, change) if chosen(a) else a for a in arrivals)


def drive(adapter: ShipAttitudeAdapter, arrivals: Iterable[Arrival], until_ns: int = 0) -> Run:
    """Hand over the arrivals with the ticks between them, as node and replay do; then tick on to ``until_ns``."""
    run, grid = Run(adapter), TickGrid()
    for arrival in arrivals:
        _tick(run, grid, arrival.receive_ns)
        published = adapter.handle(arrival.topic, arrival.message, arrival.receive_ns)
        run.published += [(arrival.receive_ns, *item) for item in published]
    _tick(run, grid, max(until_ns, run.now_ns))
    return run


def _tick(run: Run, grid: TickGrid, now_ns: int) -> None:
    for tick_ns in grid.due(now_ns):
        run.published += [(tick_ns, *item) for item in run.adapter.tick(tick_ns)]
    run.now_ns = now_ns


@functools.cache
def clean_run() -> Run:
    """The voyage with nothing wrong."""
    return drive(new_adapter(), voyage())
