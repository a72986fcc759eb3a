"""Places of theodolites and directions to a target, by pyerfa's routines and the formulas here."""

from typing import Any

import erfa
import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import make_header
from ship_geometry.earth.geodetic import GeodeticPosition
from theodolite_calib.triangulation.triangulation import RefractionConfig, Station

ORIGIN = GeodeticPosition(np.deg2rad(31.945213), np.deg2rad(120.293086), 20.0)
AIR = RefractionConfig(coefficient=0.13, sigma=0.06)
PLACE_SIGMA_M = 0.01
EARTH_RADIUS_M = 6_371_000.0


def axes_at(longitude: float, latitude: float) -> np.ndarray:
    """Return North, Up, East in ECEF, as rows."""
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    return np.array([np.cross(up, east), up, east])


ORIGIN_M = erfa.gd2gc(1, ORIGIN.longitude, ORIGIN.latitude, ORIGIN.height_m)
AXES = axes_at(ORIGIN.longitude, ORIGIN.latitude)


def station(name: str, place_n: np.ndarray) -> Station:
    longitude, latitude, height_m = erfa.gc2gd(1, ORIGIN_M + place_n @ AXES)
    return Station(name, GeodeticPosition(float(latitude), float(longitude), float(height_m)), PLACE_SIGMA_M)


def seen_direction(at: Station, true_foot_m: np.ndarray, target_m: np.ndarray, coefficient: float) -> np.ndarray:
    """Return the direction (North, Up, East of the station) of a target in ECEF, raised by refraction."""
    north, up, east = axes_at(at.position.longitude, at.position.latitude) @ (target_m - true_foot_m)
    horizontal_m = np.hypot(north, east)
    elevation = np.arctan2(up, horizontal_m) + coefficient * horizontal_m / (2.0 * EARTH_RADIUS_M)
    azimuth = np.arctan2(east, north)
    return np.array([np.cos(azimuth) * np.cos(elevation), np.sin(elevation), np.sin(azimuth) * np.cos(elevation)])


FACTORY = RosbagsFactory()
DIRECTION = "ship_msgs/msg/TargetDirection"


def direction_message(
    time_ns: int, direction_n: np.ndarray, sigma: float, factory: MessageFactory = FACTORY, **changes: Any
) -> Any:
    """Return a theodolite's message of a target in a direction (North, Up, East), with a sigma, rad."""
    enu = [2, 0, 1]
    across = sigma**2 * (np.eye(3) - np.outer(direction_n, direction_n))
    unknown = dict.fromkeys("xyz", float("nan"))
    east, north, up = direction_n[enu]
    fields: dict[str, Any] = {
        "header": make_header(factory, time_ns, "horizon"),
        "target_id": "buoy",
        "azimuth": float(np.arctan2(east, north)),
        "elevation": float(np.arcsin(up)),
        "covariance": np.full(4, np.nan),
        "direction": factory.make("geometry_msgs/msg/Vector3", x=east, y=north, z=up),
        "direction_covariance": across[np.ix_(enu, enu)].ravel(),
        "position": factory.make("geometry_msgs/msg/Vector3", **unknown),
        "position_covariance": np.full(9, np.nan),
        "status": 0,
    }
    return factory.make(DIRECTION, **{**fields, **changes})


def buoy_n(since_s: float) -> np.ndarray:
    """Return the position of a buoy 2 km away that drifts at 2.2 m/s: (North, Up, East) from the origin, m."""
    return np.array([2000.0 + 2.0 * since_s, 3.0, -400.0 + 1.0 * since_s])


def theodolite_n(number: int) -> np.ndarray:
    """Return the place of one of the theodolites, 50 m from the next: (North, Up, East) from the origin."""
    return np.array([50.0 * number, 0.0, 0.0])


def buoy_direction(number: int, since_s: float) -> np.ndarray:
    """Return the apparent direction (North, Up, East) of the buoy from one of the theodolites, raised by refraction."""
    at = station(f"t{number}", theodolite_n(number))
    return seen_direction(
        at, ORIGIN_M + theodolite_n(number) @ AXES, ORIGIN_M + buoy_n(since_s) @ AXES, AIR.coefficient
    )


def triangulation_values(count: int) -> dict[str, Any]:
    """Return nested parameters with the places of the origin and of the theodolites; places and air have sigma 0."""
    stations = {}
    for number in range(count):
        at = station(f"t{number}", theodolite_n(number))
        stations[at.name] = {**_position(at.position), "sigma_m": 0.0}
    air = {"coefficient": AIR.coefficient, "sigma": 0.0}
    return {"origin": _position(ORIGIN), "stations": stations, "refraction": air}


def _position(place: GeodeticPosition) -> dict[str, float]:
    return {
        "latitude_deg": float(np.rad2deg(place.latitude)),
        "longitude_deg": float(np.rad2deg(place.longitude)),
        "height_m": float(place.height_m),
    }
