"""A small session for the tests of the adapter: a mount stabilised against the ship's motion, and two lights.

The line of sight drifts over the bow, so that the azimuth encoder wraps from 2 pi to 0 in the middle. All values are
computed from formulas and one seed, so two runs differ only if their messages differ.
"""

import copy
import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.stamps import make_header
from ship_estimation.parameters.schema import build
from ship_geometry.frames import (
    ENU_FROM_HORIZON,
    flu_from_device_vector,
    quaternion_from_rotation,
    rotation_from_angles,
)
from ship_geometry.mount.axes import AxisErrors, encoder_angles, main_axis_rotation
from ship_geometry.mount.image import Camera
from ship_geometry.mount.line_of_sight import EARTH_RADIUS_M
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation, log_rotation
from ship_testing.adapter_runs import (
    FACTORY,
    SECOND_NS,
    START_NS,
    AdapterRun,
    Arrival,
    hand_over,
    sort_by_arrival,
    stamp_of,
)
from ship_testing.simulated_sightings import project, raise_elevation
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.config import OpticalAxisConfig

ENCODER, SHIP, INS, BEACONS = "theodolite/encoder", "ship/attitude", "ins/imu", "theodolite/beacons"
BASELINE = {"alpha": "beacon/alpha/baseline", "bravo": "beacon/bravo/baseline"}
IMU = {"alpha": "beacon/alpha/imu", "bravo": "beacon/bravo/imu"}
ALL_TOPICS = (ENCODER, SHIP, BEACONS, *BASELINE.values(), *IMU.values())
BEACONS_DEG = {"alpha": (3.0, 2.0), "bravo": (-2.0, -3.0)}
AXES = AxisErrors(*(ARCSEC * np.array([25.0, -15.0, 12.0, -20.0, 18.0, -10.0, 0.0])).tolist())
LEVER_D, LENS_M, BEACON_B = np.array([12.0, 3.0, -2.0]), np.array([0.4, 0.3, 0.0]), np.array([0.1, -0.3, 0.05])
FOCAL_LENGTH_M, DISTANCE_M, K = 0.10005, 2000.0, 0.13

_PERIOD_NS = {ENCODER: 50_000_000, SHIP: 50_000_000, BEACONS: 500_000_000}
_PERIOD_NS |= dict.fromkeys(BASELINE.values(), 200_000_000) | dict.fromkeys(IMU.values(), 100_000_000)
_PHASE_NS = {ENCODER: 0, SHIP: 17_000_000, BEACONS: 137_000_000}
_LATENCY_NS = {ENCODER: 3_000_000, SHIP: 8_000_000, BEACONS: 90_000_000}
_DEVICE_LATENCY_NS = 60_000_000
_RTK_M, _IMAGE_M, _ENCODER_RAD, _SHIP_RAD = 0.01, 0.65e-6, 1.0 * ARCSEC, 1.5 * ARCSEC


@dataclass
class Run(AdapterRun):
    """A run of optical_axis."""

    adapter: OpticalAxisAdapter

    @property
    def pointings(self) -> list[Any]:
        return self.messages("theodolite/pointing")

    def state(self) -> tuple[Any, ...]:
        """Return the filter's state, bit-exact, without the count of rejections."""
        state = self.adapter.core.state
        return (
            state.time_ns,
            state.mean.tobytes(),
            state.covariance_by_source.tobytes(),
            state.last_beacons_ns,
            state.sighting_count,
        )


def config(**changes: Any) -> OpticalAxisConfig:
    """Return the configuration of the session, with dotted parameters changed (``__`` for the dot)."""
    light = dict(zip(("forward_m", "up_m", "right_m"), BEACON_B.tolist(), strict=True))
    beacon = {"light": light, "rtk": {"bias_sigma_m": 0.0, "sigma_m": _RTK_M}}
    values: dict[str, Any] = {
        "encoder": {"frame_id": "theodolite_base"},
        "ship": {"frame_id": "deck"},
        "telescope": {
            "telescope_id": "main",
            "frame_id": "telescope",
            "focal_length_m": 0.1,
            "sigma_m": _IMAGE_M,
            "lens": dict(zip(("forward_m", "up_m", "right_m"), LENS_M.tolist(), strict=True)),
        },
        "lever": dict(zip(("forward_m", "up_m", "right_m"), LEVER_D.tolist(), strict=True)),
        "beacons": {"alpha": copy.deepcopy(beacon), "bravo": copy.deepcopy(beacon)},
    }
    for dotted, value in changes.items():
        *groups, leaf = dotted.split("__")
        group = values
        for name in groups:
            group = group.setdefault(name, {})
        group[leaf] = value
    return build(OpticalAxisConfig, values)


def new_adapter(**changes: Any) -> OpticalAxisAdapter:
    return OpticalAxisAdapter(config(**changes), FACTORY)


def deck(t_s: float) -> FloatArray:
    """Return horizon from deck: swell of 0.5° in heading, 2° in pitch, 4° in roll."""
    swing = np.sin(2.0 * np.pi * t_s / np.array([30.0, 8.0, 11.0]) + np.array([0.0, 0.0, 0.3]))
    return rotation_from_angles(*np.deg2rad(np.array([34.4, 0.0, 0.0]) + np.array([0.5, 2.0, 4.0]) * swing))


def line_of_sight(t_s: float) -> FloatArray:
    """Return horizon from the upright frame of the main axis, which drifts over the bow."""
    return rotation_from_angles(*np.deg2rad([34.4 - 4.0 + 1.5 * t_s, 30.0 + 2.0 * np.sin(t_s / 3.0), 0.0]))


def mount_state(t_s: float) -> tuple[float, float, FloatArray]:
    """Return encoder angles and the main frame in the horizon."""
    rotation_nd = deck(t_s)
    azimuth, elevation = encoder_angles(AXES, rotation_nd.T @ line_of_sight(t_s)[:, 0])
    return float(azimuth), float(elevation), rotation_nd @ main_axis_rotation(AXES, float(azimuth), float(elevation))


def drone_attitude(t_s: float) -> FloatArray:
    """Return horizon from drone; the drone sways in pitch and roll."""
    return rotation_from_angles(*np.deg2rad([100.0, 2.0 * np.sin(1.5 * t_s), 2.0 * np.cos(1.3 * t_s)]))


def beacon_n(name: str, t_s: float) -> FloatArray:
    """Return the vector from lens to light in the horizon, m."""
    right, up = np.tan(np.deg2rad(BEACONS_DEG[name]))
    around = np.array([1.0, up, right])
    return line_of_sight(t_s) @ (DISTANCE_M * around / np.linalg.norm(around))


def encoder_message(t_s: float, since_ns: int, noise: FloatArray) -> Any:
    azimuth, elevation, _ = mount_state(t_s)
    return FACTORY.make(
        "ship_msgs/msg/TheodoliteEncoder",
        header=make_header(FACTORY, START_NS + since_ns, "theodolite_base"),
        azimuth=float((azimuth + noise[0]) % (2.0 * np.pi)),
        elevation=float(elevation + noise[1]),
        sigma=_ENCODER_RAD,
        status=0,
    )


def ship_message(t_s: float, since_ns: int, noise: FloatArray) -> Any:
    before, after = deck(t_s - 1e-4), deck(t_s + 1e-4)
    rotation_nd = exp_rotation(-noise) @ exp_rotation(-_SHIP_RAD * np.array([0.7, -1.0, 0.4])) @ deck(t_s)
    x, y, z, w = quaternion_from_rotation(rotation_nd).tolist()
    rate = dict(zip("xyz", flu_from_device_vector(log_rotation(before.T @ after) / 2e-4).tolist(), strict=True))
    return FACTORY.make(
        "ship_msgs/msg/ShipAttitude",
        header=make_header(FACTORY, START_NS + since_ns, "deck"),
        heading=0.0,
        pitch=0.0,
        roll=0.0,
        covariance=np.zeros(9),
        orientation=FACTORY.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        rotation_covariance=((_SHIP_RAD**2 + ARCSEC**2) * np.eye(3)).ravel(),
        angular_velocity=FACTORY.make("geometry_msgs/msg/Vector3", **rate),
        status=0,
        horizon=0,
        sources=["ins"],
        star_age_s=0.1,
    )


def baseline_message(name: str, t_s: float, since_ns: int, noise: FloatArray) -> Any:
    lens_n = deck(t_s) @ LEVER_D + mount_state(t_s)[2] @ LENS_M
    baseline_n = beacon_n(name, t_s) + lens_n - drone_attitude(t_s) @ BEACON_B + noise
    east, north, up = (ENU_FROM_HORIZON @ baseline_n).tolist()
    return FACTORY.make(
        "ship_msgs/msg/RtkBaseline",
        header=make_header(FACTORY, START_NS + since_ns, "horizon"),
        base_id="ship",
        rover_id=name,
        enu=FACTORY.make("geometry_msgs/msg/Vector3", x=east, y=north, z=up),
        covariance=(_RTK_M**2 * np.eye(3)).ravel(),
        fix=4,
        age_s=0.5,
        satellites=12,
    )


def imu_message(t_s: float, since_ns: int) -> Any:
    x, y, z, w = quaternion_from_rotation(drone_attitude(t_s)).tolist()
    zero = FACTORY.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    return FACTORY.make(
        "sensor_msgs/msg/Imu",
        header=make_header(FACTORY, START_NS + since_ns, "drone"),
        orientation=FACTORY.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        orientation_covariance=np.zeros(9),
        angular_velocity=zero,
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=zero,
        linear_acceleration_covariance=np.zeros(9),
    )


def image_message(t_s: float, since_ns: int, noise: FloatArray) -> Any:
    camera = Camera(FOCAL_LENGTH_M, 0.0, np.zeros(2))
    direction_n = np.array([beacon_n(name, t_s) for name in BEACONS_DEG]) / DISTANCE_M
    horizontal_m = DISTANCE_M * np.hypot(direction_n[:, 0], direction_n[:, 2])
    seen_n = raise_elevation(direction_n, K * horizontal_m / (2.0 * EARTH_RADIUS_M))
    point_m = project(camera, np.array(FOCAL_LENGTH_M), seen_n @ mount_state(t_s)[2]) + noise
    sightings = [
        FACTORY.make("ship_msgs/msg/BeaconSighting", beacon_id=name, x=float(x), z=float(z), sigma=_IMAGE_M)
        for name, (x, z) in zip(BEACONS_DEG, point_m, strict=True)
    ]
    return FACTORY.make(
        "ship_msgs/msg/BeaconImage",
        header=make_header(FACTORY, START_NS + since_ns, "telescope"),
        telescope_id="main",
        exposure_s=0.01,
        beacons=sightings,
    )


@functools.cache
def session(duration_s: float = 6.0) -> tuple[Arrival, ...]:
    """Return all arrivals in order; change only copies of them."""
    rng = np.random.default_rng(20240202)
    makers: dict[str, Callable[[float, int], Any]] = {
        ENCODER: lambda t, ns: encoder_message(t, ns, _ENCODER_RAD * rng.standard_normal(2)),
        SHIP: lambda t, ns: ship_message(t, ns, ARCSEC * rng.standard_normal(3)),
        BEACONS: lambda t, ns: image_message(t, ns, _IMAGE_M * rng.standard_normal((2, 2))),
    }
    for name in BEACONS_DEG:
        makers[BASELINE[name]] = functools.partial(_noisy_baseline_message, name, rng)
        makers[IMU[name]] = imu_message
    arrivals = []
    for topic, maker in makers.items():
        for since_ns in range(_PHASE_NS.get(topic, 31_000_000), round(duration_s * SECOND_NS), _PERIOD_NS[topic]):
            latency_ns = _LATENCY_NS.get(topic, _DEVICE_LATENCY_NS)
            arrivals.append(Arrival(topic, maker(since_ns * 1e-9, since_ns), START_NS + since_ns + latency_ns))
    return sort_by_arrival(arrivals)


def session_with_ins_only(duration_s: float = 6.0) -> tuple[Arrival, ...]:
    """Return the session with ``ins/imu`` messages in place of ``ship/attitude``."""
    zero = FACTORY.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)

    def imu_from_ship(ship: Any) -> Any:
        return FACTORY.make(
            "sensor_msgs/msg/Imu",
            header=ship.header,
            orientation=ship.orientation,
            orientation_covariance=(ARCSEC**2 * np.eye(3)).ravel(),
            angular_velocity=ship.angular_velocity,
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=zero,
            linear_acceleration_covariance=np.zeros(9),
        )

    arrivals = session(duration_s)
    return tuple(Arrival(INS, imu_from_ship(a.message), a.receive_ns) if a.topic == SHIP else a for a in arrivals)


def _noisy_baseline_message(name: str, rng: np.random.Generator, t_s: float, since_ns: int) -> Any:
    return baseline_message(name, t_s, since_ns, _RTK_M * rng.standard_normal(3))


def error_in_sigmas(pointing: Any) -> float:
    """Return the RMS, over two axes, of the error perpendicular to the main axis, in sigmas as published."""
    t_s = (stamp_of(pointing) - START_NS) * 1e-9
    truth_nm = mount_state(t_s)[2]
    estimate_nm = rotation_from_angles(pointing.azimuth, pointing.elevation, pointing.image_rotation)
    error_n = log_rotation(truth_nm @ estimate_nm.T)
    covariance_n = ENU_FROM_HORIZON.T @ np.array(pointing.rotation_covariance).reshape(3, 3) @ ENU_FROM_HORIZON
    across = estimate_nm[:, 1:].T
    return float(
        np.sqrt(error_n @ across.T @ np.linalg.solve(across @ covariance_n @ across.T, across @ error_n) / 2.0)
    )


def run_adapter(adapter: OpticalAxisAdapter, arrivals: Iterable[Arrival], until_ns: int = 0) -> Run:
    """Give the arrivals to the adapter with the ticks between them, as in node and replay; tick on to ``until_ns``."""
    run = Run(adapter)
    hand_over(run, arrivals, until_ns)
    return run


@functools.cache
def fault_free_run() -> Run:
    """Return the run of the session without faults."""
    return run_adapter(new_adapter(), session())
