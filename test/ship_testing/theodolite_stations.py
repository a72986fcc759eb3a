"""Where theodolites stand and in what direction they see a target, by pyerfa's own routines and the formulas here."""

import erfa
import numpy as np

from ship_geometry.geodetic import GeodeticPosition
from theodolite_calib.target.triangulation import Air, Station

ORIGIN = GeodeticPosition(np.deg2rad(31.945213), np.deg2rad(120.293086), 20.0)
AIR = Air(0.13, 0.06)
PLACE_SIGMA_M = 0.01
EARTH_RADIUS_M = 6_371_000.0


def axes_at(longitude: float, latitude: float) -> np.ndarray:
    """North, Up, East in ECEF, as rows."""
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    return np.array([np.cross(up, east), up, east])


ORIGIN_M = erfa.gd2gc(1, ORIGIN.longitude, ORIGIN.latitude, ORIGIN.height_m)
AXES = axes_at(ORIGIN.longitude, ORIGIN.latitude)


def station(name: str, place_n: np.ndarray) -> Station:
    longitude, latitude, height_m = erfa.gc2gd(1, ORIGIN_M + place_n @ AXES)
    return Station(name, GeodeticPosition(float(latitude), float(longitude), float(height_m)), PLACE_SIGMA_M)


def seen(at: Station, true_foot_m: np.ndarray, target_m: np.ndarray, coefficient: float) -> np.ndarray:
    """The direction (North, Up, East of the station) in which a target in ECEF is seen, raised by the air."""
    north, up, east = axes_at(at.place.longitude, at.place.latitude) @ (target_m - true_foot_m)
    horizontal_m = np.hypot(north, east)
    elevation = np.arctan2(up, horizontal_m) + coefficient * horizontal_m / (2.0 * EARTH_RADIUS_M)
    azimuth = np.arctan2(east, north)
    return np.array([np.cos(azimuth) * np.cos(elevation), np.sin(elevation), np.sin(azimuth) * np.cos(elevation)])
