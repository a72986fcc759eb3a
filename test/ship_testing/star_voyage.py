"""A ship under the real sky for the tests of ``star_attitude``: two star sensors at 5 Hz, an INS, fixes, weather.

The ship and its INS are those of small_voyage. The directions of the stars are computed by the functions of
ship_geometry.earth.star_directions, which the node does not use, and projected by the camera.
"""

import functools
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_bags.stamps import make_header
from ship_estimation.parameters.schema import build
from ship_geometry.air.refraction import Weather, elevation_of, raised_directions, refraction
from ship_geometry.earth.earth_orientation import earth_orientation_table
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.earth.star_directions import Observer, directions
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_stars.camera.camera import StarCamera
from ship_stars.sky.catalogue import hipparcos
from ship_testing.adapter_runs import FACTORY, SECOND_NS, START_NS, Arrival, exact_value, sort_by_arrival
from ship_testing.small_voyage import INS, Run, attitude, run_adapter
from ship_testing.small_voyage import voyage as small_voyage

FORE, STARBOARD = "star/fore/observations", "star/starboard/observations"
FIX, PRESSURE, TEMPERATURE, HUMIDITY = "gnss/fix", "met/pressure", "met/temperature", "met/humidity"
HEADING_DEG = 34.4
AZIMUTH_DEG = {FORE: 0.0, STARBOARD: 90.0}
PHASE_NS = {FORE: 13_000_000, STARBOARD: 77_000_000}
PERIOD_NS, LATENCY_NS = 200_000_000, 120_000_000

WEATHER = Weather(1008.3, 28.2, 0.6)
LATITUDE_DEG, LONGITUDE_DEG = 31.945213, 120.293086
NORTH_M_PER_S, EAST_M_PER_S = 6.0, -5.0

# 24 µm of 60 mm: a pixel is 82.5″, the field 23°.
SIZE_PX, STARS = 1024, 8
CAMERA = StarCamera(0.06, 24e-6, 511.5, 511.5)
CAMERA_PARAMETERS = {
    "focal_length_m": 0.06,
    "pixel_pitch_m": 24e-6,
    "principal_u_px": 511.5,
    "principal_v_px": 511.5,
    "centroid_sigma_px": 0.04,
}
EXACT_CAMERA = {
    **CAMERA_PARAMETERS,
    "focal_length_sigma_m": 1e-12,
    "principal_sigma_px": 0.0,
    "distortion_sigma": 0.0,
}
"""The same camera with optics without errors."""
EXACT_OPTICS = {f"star_sensors__{id_}__camera": EXACT_CAMERA for id_ in ("fore", "starboard")}
"""Changes of :func:`config` that set :data:`EXACT_CAMERA` for both sensors."""
SIGMA_PX = 0.04
"""Standard deviation of a star's coordinates on the detector, px (3.3″)."""


def config(**changes: Any) -> StarAttitudeConfig:
    """Return the configuration of the voyage, with dotted parameters changed (``__`` for the dot)."""
    star = {"elevation_deg": 45.0, "camera": CAMERA_PARAMETERS}
    values: dict[str, Any] = {
        "ins": {"frame_id": "ins"},
        "star_sensors": {
            "fore": {**star, "azimuth_deg": 0.0, "frame_id": "star_fore"},
            "starboard": {**star, "azimuth_deg": 90.0, "frame_id": "star_starboard"},
        },
    }
    for dotted, value in changes.items():
        *groups, leaf = dotted.split("__")
        group = values
        for name in groups:
            group = group.setdefault(name, {})
        group[leaf] = value
    return build(StarAttitudeConfig, values)


def new_adapter(**changes: Any) -> StarAttitudeAdapter:
    return StarAttitudeAdapter(config(**changes), FACTORY)


def true_deck(since_ns: int) -> FloatArray:
    return attitude(since_ns * 1e-9, HEADING_DEG)


def true_sensor(topic: str, since_ns: int, mounting_error_s: FloatArray | None = None) -> FloatArray:
    """Return horizon from sensor."""
    rotation_ds = rotation_from_angles(*np.deg2rad([AZIMUTH_DEG[topic], 45.0, 0.0]))
    if mounting_error_s is not None:
        rotation_ds = rotation_ds @ exp_rotation(mounting_error_s)
    return true_deck(since_ns) @ rotation_ds


def true_place(since_ns: int) -> GeodeticPosition:
    # Metres per radian of latitude and of longitude at 31.9° on WGS 84, near enough for a speed.
    north_m, east_m = NORTH_M_PER_S * since_ns * 1e-9, EAST_M_PER_S * since_ns * 1e-9
    latitude = np.deg2rad(LATITUDE_DEG) + north_m / 6_353_000.0
    return GeodeticPosition(latitude, np.deg2rad(LONGITUDE_DEG) + east_m / (6_384_100.0 * np.cos(latitude)), 20.0)


def true_directions(rows: FloatArray, since_ns: int) -> FloatArray:
    """Return apparent directions of catalogue stars in the horizon, with air."""
    time_ns = START_NS + since_ns
    observer = Observer(true_place(since_ns), np.array([NORTH_M_PER_S, 0.0, EAST_M_PER_S]))
    stars = hipparcos().at_j2000[rows]
    without_air = directions(stars, np.array(time_ns), observer, earth_orientation_table().at(time_ns))
    return raised_directions(without_air, refraction("erfa", elevation_of(without_air), WEATHER).angle)


@functools.cache
def _bright_rows() -> FloatArray:
    return hipparcos().rows_brighter_than(5.0)


def bright_stars(topic: str, since_ns: int, count: int = STARS) -> tuple[FloatArray, FloatArray]:
    """Return rows in the catalogue of the brightest stars in the field, and their pixels without error."""
    rows = _bright_rows()
    directions_n = true_directions(rows, since_ns)
    pixels = CAMERA.pixels(directions_n @ true_sensor(topic, since_ns))
    inside = np.flatnonzero(np.all((pixels > 0) & (pixels < SIZE_PX - 1), axis=-1))
    brightest = inside[np.argsort(hipparcos().magnitude[rows[inside]], kind="stable")][:count]
    assert len(brightest) == count
    return rows[brightest], pixels[brightest]


def streak_means(topic: str, since_ns: int, pixels: FloatArray, exposure_s: float) -> FloatArray:
    """Return the mean pixels of stars over an exposure, from the sensor's true attitude at two hundred times."""
    directions_s, middle = CAMERA.directions(pixels), true_sensor(topic, since_ns)
    offsets_ns = (exposure_s * 1e9 * ((np.arange(200) + 0.5) / 200 - 0.5)).astype(int)
    turns = [true_sensor(topic, since_ns + ns).T @ middle for ns in offsets_ns.tolist()]
    return np.mean([CAMERA.pixels(directions_s @ turn.T) for turn in turns], axis=0)


def observations(
    topic: str,
    since_ns: int,
    noise_px: FloatArray | float = 0.0,
    count: int = STARS,
    exposure_s: float = np.nan,
) -> Any:
    """Return a sensor's message of its stars; points if no exposure time is given, else streaks."""
    sensor = topic.split("/")[1]
    rows, pixels = bright_stars(topic, since_ns, count)
    if exposure_s > 0.0:
        pixels = streak_means(topic, since_ns, pixels, exposure_s)
    u, v = (pixels + noise_px).T
    return FACTORY.make(
        "ship_msgs/msg/StarObservationArray",
        header=make_header(FACTORY, START_NS + since_ns, f"star_{sensor}"),
        sensor_id=sensor,
        exposure_s=exposure_s,
        stars=[
            FACTORY.make(
                "ship_msgs/msg/StarObservation",
                catalogue_id=int(hipparcos().hip[row]),
                right_ascension=np.nan,
                declination=np.nan,
                u=float(u[index]),
                v=float(v[index]),
                sigma_px=SIGMA_PX,
                magnitude=float(hipparcos().magnitude[row]),
            )
            for index, row in enumerate(rows)
        ],
    )


def fix(since_ns: int) -> Any:
    place = true_place(since_ns)
    return FACTORY.make(
        "sensor_msgs/msg/NavSatFix",
        header=make_header(FACTORY, START_NS + since_ns, "gnss"),
        status=FACTORY.make("sensor_msgs/msg/NavSatStatus", status=0, service=1),
        latitude=float(np.rad2deg(place.latitude)),
        longitude=float(np.rad2deg(place.longitude)),
        altitude=float(place.height_m),
        position_covariance=np.diag([4.0, 4.0, 16.0]).ravel(),
        position_covariance_type=2,
    )


def air(topic: str, since_ns: int) -> Any:
    kind, field, value, sigma = {
        PRESSURE: ("FluidPressure", "fluid_pressure", 100.0 * WEATHER.pressure_hpa, 50.0),
        TEMPERATURE: ("Temperature", "temperature", WEATHER.temperature_c, 1.0),
        HUMIDITY: ("RelativeHumidity", "relative_humidity", WEATHER.relative_humidity, 0.0),
    }[topic]
    header = make_header(FACTORY, START_NS + since_ns, "mast")
    return FACTORY.make(f"sensor_msgs/msg/{kind}", header=header, **{field: value}, variance=sigma**2)


@functools.cache
def voyage(duration_s: float = 3.0, noise: bool = False) -> tuple[Arrival, ...]:
    """Return all arrivals in order; change only copies of them."""
    rng = np.random.default_rng(20240704)
    arrivals = [arrival for arrival in small_voyage(5.0) if arrival.topic == INS]
    end_ns = round(duration_s * SECOND_NS)
    arrivals = [arrival for arrival in arrivals if arrival.receive_ns < START_NS + end_ns]
    for topic, phase_ns in PHASE_NS.items():
        for since_ns in range(phase_ns, end_ns, PERIOD_NS):
            noise_px = SIGMA_PX * rng.standard_normal((STARS, 2)) if noise else 0.0
            message = observations(topic, since_ns, noise_px)
            arrivals.append(Arrival(topic, message, START_NS + since_ns + LATENCY_NS))
    for since_ns in range(-2 * SECOND_NS, end_ns, SECOND_NS):
        arrivals.append(Arrival(FIX, fix(since_ns), START_NS + since_ns + 50_000_000))
        arrivals += [
            Arrival(topic, air(topic, since_ns), START_NS + since_ns + 10_000_000)
            for topic in (PRESSURE, TEMPERATURE, HUMIDITY)
        ]
    return sort_by_arrival(arrivals)


def with_topics(arrivals: Iterable[Arrival], *topics: str) -> tuple[Arrival, ...]:
    return tuple(arrival for arrival in arrivals if arrival.topic in topics)


def without_topics(arrivals: Iterable[Arrival], *topics: str) -> tuple[Arrival, ...]:
    return tuple(arrival for arrival in arrivals if arrival.topic not in topics)


def run_new_adapter(arrivals: Iterable[Arrival], **changes: Any) -> Run:
    """Give all arrivals to a new adapter, and continue for one second."""
    taken = tuple(arrivals)
    return run_adapter(new_adapter(**changes), taken, until_ns=taken[-1].receive_ns + SECOND_NS)


@functools.cache
def voyage_with_streaks(exposure_s: float = 0.2) -> tuple[Arrival, ...]:
    """Return the voyage without noise of the centroids, with an exposure time."""
    return tuple(
        replace(a, message=observations(a.topic, a.stamp_ns - START_NS, exposure_s=exposure_s))
        if a.topic in PHASE_NS
        else a
        for a in voyage()
    )


@functools.cache
def fault_free_run() -> Run:
    """Return the run of the voyage without faults."""
    return run_new_adapter(voyage())


def published_bytes(run: Run) -> list[tuple[str, bytes]]:
    """Return all published solutions and budgets, bit-exact."""
    topics = [output.topic for output in run.adapter.outputs if output.topic.startswith("star/")]
    return [
        (topic, exact_value(message))
        for _, topic, message in run.published
        if topic in topics and topic != "star/innovation"
    ]


def solution_rotation(message: Any) -> FloatArray:
    return rotation_from_angles(message.azimuth, message.elevation, message.roll)


MAS = 1e-3 * ARCSEC
