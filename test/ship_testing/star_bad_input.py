"""Changes that make a message or a single star unusable, with the expected reason of rejection and text."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ship_estimation.rejection_rules import Reason
from ship_testing.adapter_runs import (
    SECOND_NS,
    stamp_of,
)
from ship_testing.small_voyage import INS
from ship_testing.star_voyage import (
    FIX,
    FORE,
    HUMIDITY,
    PRESSURE,
)

SOURCE = {FORE: "star.fore", INS: "ins", FIX: FIX, PRESSURE: PRESSURE, HUMIDITY: HUMIDITY}

FORE_SOLUTION = "star/fore/solution"

Change = Callable[[Any], None]

def set_field(path: str, value: Any) -> Change:
    """Return a function that sets a field of a message; a path is, for example, ``header.frame_id``."""
    *parents, leaf = path.split(".")

    def change(message: Any) -> None:
        setattr(functools.reduce(getattr, parents, message), leaf, value)

    return change

def stamp_ahead(seconds: float) -> Change:
    def change(message: Any) -> None:
        ns = stamp_of(message) + round(seconds * SECOND_NS)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(ns, SECOND_NS)

    return change

def clear_stamp(message: Any) -> None:
    message.header.stamp.sec = message.header.stamp.nanosec = 0

def clear_fix(message: Any) -> None:
    message.status.status = -1

REJECTED_MESSAGES = [
    ("exposure stamp zero", FORE, clear_stamp, "bad_stamp", "0 ns"),
    ("exposure from the future", FORE, stamp_ahead(0.18), "future", "0.060 s ahead"),
    ("exposure of another sensor", FORE, set_field("sensor_id", "aft"), "unknown_sensor", "'aft': expected 'fore'"),
    ("exposure in another frame", FORE, set_field("header.frame_id", "aft"), "frame", "'aft': expected 'star_fore'"),
    ("fix without fix", FIX, clear_fix, "no_fix", "STATUS_NO_FIX"),
    ("fix NaN", FIX, set_field("latitude", np.nan), "non_finite", "latitude"),
    ("fix in minutes", FIX, set_field("longitude", 7217.6), "units", "expected degrees"),
    ("fix stamp zero", FIX, clear_stamp, "bad_stamp", "0 ns"),
    ("pressure in hPa", PRESSURE, set_field("fluid_pressure", 1008.3), "units", "hPa, not Pa?"),
    ("humidity in percent", HUMIDITY, set_field("relative_humidity", 60.0), "units", "percent?"),
    ("ins quaternion NaN", INS, set_field("orientation.x", np.nan), "non_finite", "orientation"),
    ("ins frame", INS, set_field("header.frame_id", "imu"), "frame", "'imu': expected 'ins'"),
]

def set_star_fields(row: int, **fields: Any) -> Change:
    def change(message: Any) -> None:
        for name, value in fields.items():
            setattr(message.stars[row], name, value)

    return change

def remove_star(row: int) -> Change:
    def change(message: Any) -> None:
        del message.stars[row]

    return change

REJECTED_STARS = [
    ("pixel NaN", set_star_fields(3, u=np.nan), Reason.NON_FINITE, "pixel (nan"),
    ("pixel nonsense", set_star_fields(3, v=1e12), Reason.UNITS, "1e+12"),
    ("sigma negative", set_star_fields(3, sigma_px=-1.0), Reason.BAD_COVARIANCE, "sigma_px -1"),
    (
        "unknown number",
        set_star_fields(3, catalogue_id=900_000),
        Reason.UNKNOWN_STAR,
        "HIP 900000: HIP 900000 is not in",
    ),
    (
        "right ascension in degrees",
        set_star_fields(3, catalogue_id=0, right_ascension=310.36, declination=0.79),
        Reason.UNITS,
        "degrees?",
    ),
    # Achernar, declination -57°: at 32° north this star hardly rises, and here it is below the horizon.
    ("below the horizon", set_star_fields(3, catalogue_id=7588), Reason.BELOW_HORIZON, "HIP 7588: elevation -"),
]
