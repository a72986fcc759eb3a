"""A short voyage for the tests of the adapter: a ship in a swell, with an INS at 25 Hz and two star sensors at 5 Hz.

All values are computed from formulas and one seed, so two runs differ only if their messages differ.
"""

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.stamps import make_header
from ship_estimation.parameters.schema import build
from ship_geometry.frames import (
    angles_from_rotation,
    enu_covariance,
    flu_from_device_vector,
    quaternion_from_rotation,
    rotation_from_angles,
    rotation_from_quaternion,
)
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_testing.adapter_runs import (
    FACTORY,
    SECOND_NS,
    START_NS,
    AdapterRun,
    Arrival,
    changed_copy,
    hand_over,
    sort_by_arrival,
    stamp_of,
)

INS = "ins/imu"
FORE = "star/fore/horizon_attitude"
STARBOARD = "star/starboard/horizon_attitude"

_INS_PERIOD_NS, _INS_LATENCY_NS = 40_000_000, 5_000_000
_STAR_PERIOD_NS, _STAR_LATENCY_NS = 200_000_000, 120_000_000
_STAR_PHASE_NS = {FORE: 13_000_000, STARBOARD: 77_000_000}
_STAR_AZIMUTH_DEG = {FORE: 0.0, STARBOARD: 90.0}
_INS_ERROR_N = np.array([10.0, 60.0, -8.0]) * ARCSEC
_TAU_S = 0.003
_STAR_NOISE_V = np.diag((np.array([100.0, 3.0, 3.0]) * ARCSEC) ** 2)


@dataclass
class Run(AdapterRun):
    """A run of ship_attitude."""

    adapter: ShipAttitudeAdapter

    def state(self) -> tuple[Any, ...]:
        """Return the filter's state, bit-exact, without the count of rejections."""
        state = self.adapter.core.state
        common = {name: matrix.tobytes() for name, matrix in state.common_n.items()}
        return (
            state.time_ns,
            state.mean.tobytes(),
            state.covariance_by_source.tobytes(),
            common,
            dict(state.last_used_ns),
        )


def config(**changes: Any) -> ShipAttitudeConfig:
    """Return the configuration of the voyage, with dotted parameters changed (``__`` for the dot)."""
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
    """Return horizon from deck: swell of 0.5° in heading, 2° in pitch, 4° in roll."""
    swing = np.sin(2.0 * np.pi * t_s / np.array([30.0, 8.0, 11.0]) + np.array([0.0, 0.0, 0.3]))
    return rotation_from_angles(*np.deg2rad(np.array([heading_deg, 0.0, 0.0]) + np.array([0.5, 2.0, 4.0]) * swing))


@functools.cache
def voyage(duration_s: float = 5.0, heading_deg: float = 34.4) -> tuple[Arrival, ...]:
    """Return all arrivals in order; change only copies of them."""
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
    return sort_by_arrival(arrivals)


def ins_message(since_ns: int, heading_deg: float, white_n: FloatArray) -> Any:
    """Return an INS message valid at its stamp + ``_TAU_S``.

    The true attitude is exp(a) exp(w) measured, with the INS error a and the white noise w.
    """
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
    """Return a star sensor's message of its attitude."""
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


def run_adapter(adapter: ShipAttitudeAdapter, arrivals: Iterable[Arrival], until_ns: int = 0) -> Run:
    """Give the arrivals to the adapter with the ticks between them, as in node and replay; tick on to ``until_ns``."""
    run = Run(adapter)
    hand_over(run, arrivals, until_ns)
    return run


def remove_interval(arrivals: tuple[Arrival, ...], from_s: float, until_s: float, *topics: str) -> tuple[Arrival, ...]:
    """Return the arrivals, except the arrivals on these topics with stamps in [from_s, until_s) after the start."""
    from_ns, until_ns = (START_NS + round(s * SECOND_NS) for s in (from_s, until_s))
    return tuple(a for a in arrivals if a.topic not in topics or not from_ns <= a.stamp_ns < until_ns)


def turn_star_messages(
    arrivals: Iterable[Arrival], turn_n: FloatArray, from_s: float, until_s: float = np.inf
) -> list[Arrival]:
    """Return the arrivals with all star attitudes rotated about North, Up and East, rad."""

    def change(message: Any) -> None:
        rotation_nv = exp_rotation(turn_n) @ rotation_from_angles(message.azimuth, message.elevation, message.roll)
        message.azimuth, message.elevation, message.roll = angles_from_rotation(rotation_nv).tolist()

    def is_turned(arrival: Arrival) -> bool:
        return arrival.topic in (FORE, STARBOARD) and from_s <= (arrival.stamp_ns - START_NS) / SECOND_NS < until_s

    return [changed_copy(one, change) if is_turned(one) else one for one in arrivals]


def since_start_s(message: Any) -> float:
    return (stamp_of(message) - START_NS) * 1e-9


def rotation_of(message: Any) -> np.ndarray:
    q = message.orientation
    return rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))


def assert_consistent(message: Any, heading_deg: float = 34.4) -> None:
    """Assert that the error of the attitude about each axis is below five published sigmas."""
    true_nd = attitude(since_start_s(message), heading_deg)
    error_n = log_rotation(true_nd @ rotation_of(message).T)
    variance_enu = np.diagonal(np.reshape(message.rotation_covariance, (3, 3)))
    sigma_n = np.sqrt(variance_enu[[1, 2, 0]])
    assert np.all(np.abs(error_n) < 5.0 * sigma_n), (error_n / ARCSEC, sigma_n / ARCSEC)


@functools.cache
def fault_free_run() -> Run:
    """Return the run of the voyage without faults."""
    return run_adapter(new_adapter(), voyage())
