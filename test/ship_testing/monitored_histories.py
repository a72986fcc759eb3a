"""Ten minutes of a monitored suite, drawn with a seed: input of panels in tests without a suite.

A star sensor is displaced 40 s before the end, stars are missing for 27 s about six minutes before the end, and an
event reports the return of a light. This is the example in the design of the page.
"""

from collections import deque
from dataclasses import replace

import numpy as np

from ship_geometry.rotations import ARCSEC
from ship_testing.suite_states import SHIFTED_SENSOR, late_input, source, state_with_mounting_shift
from ship_watch.history.history import (
    BeaconPoint,
    BudgetPoint,
    ErrorPoint,
    ExposurePoint,
    History,
    InnovationPoint,
    ParameterEstimate,
)
from ship_watch.suite_state import Event, SuiteState

NOW_NS = 1_404_907_207_000_000_000
"""2014-07-09 12:00:07 UTC, as in the figures of the page's design."""

SHIFT_AGE_S = 40.0
SHIFT_RIGHT_ARCSEC = 49.0
NO_STARS_S = (-374.0, -347.0)
_SECOND = 1_000_000_000


def simulated_history(seed: int = 3, length_s: float = 600.0, *, has_truth: bool = True) -> History:
    """Return the history that plots draw."""
    rng = np.random.default_rng(seed)
    history = History()
    for name in ("star.fore", "star.starboard"):
        history.innovations[name] = deque(_innovations(rng, name, length_s))
    history.innovations["lights"] = deque(_innovations(rng, "lights", length_s))
    at_s = np.arange(-length_s, 0.0, 1.0)
    sigma = {"heading": 2.2, "pitch": 1.4, "roll": 1.9}
    history.errors["ship/error_arcsec"] = deque(_errors(rng, at_s, sigma, has_truth))
    pointing = {"azimuth_cos_elevation": 2.5, "elevation": 2.7, "image_rotation": 30.0}
    history.errors["theodolite/error_arcsec"] = deque(_errors(rng, at_s, pointing, has_truth))
    history.budgets["ship/error_budget"] = deque(_budget_point(at_second) for at_second in at_s)
    for name, x, z in (("a", -5e-3, -4e-3), ("b", 3.6e-3, 5.0e-3)):
        history.beacons[name] = deque(_beacon_points(rng, x, z))
    history.star_exposures = {
        "star.fore": _star_residuals(rng, 0.45, 0.92),
        "star.starboard": _star_residuals(rng, 2.17, 0.85, SHIFT_RIGHT_ARCSEC),
    }
    aligned = (("ins.north", 3.5), ("ins.up", 62.9), ("ins.east", 19.3), ("star.fore.azimuth", -2.5))
    history.alignment = (
        *(ParameterEstimate(name, value * ARCSEC, 0.6 * ARCSEC, "rad", True, 0.0) for name, value in aligned),
        ParameterEstimate("ins.time_offset", 3.5e-4, 2e-5, "s", True, 0.0),
    )
    history.calibration = tuple(
        ParameterEstimate(name, value * ARCSEC, sigma * ARCSEC, "rad", name != "beta_y", 0.0)
        for name, value, sigma in (
            ("g", 19.3, 6.8), ("h", 24.5, 1.1), ("c", -21.1, 2.0), ("beta_x", -23.8, 4.8), ("beta_y", -5.5, 90.0)
        )
    )  # fmt: skip
    history.position = (np.deg2rad(31.945), np.deg2rad(120.293))
    return history


def simulated_state(now_ns: int = NOW_NS) -> SuiteState:
    """Return the suite state at the end of the history."""
    good = source("star.fore", topics=("star/fore/observations",))
    bad = replace(SHIFTED_SENSOR, out_since_ns=now_ns - int(SHIFT_AGE_S * 1e9))
    topics = ("gnss/fix", "ins/imu", "met/pressure", *good.topics, *bad.topics)
    inputs = [late_input(topic, 0.1) for topic in topics]
    inputs[-1] = replace(inputs[-1], rejected_60s=81, reasons={"gate": 9, "attitude_conflict": 72, "too_few_stars": 56})
    events = (
        Event(now_ns - 36 * _SECOND, "state", "roll", "roll SAFE → CAUTION, over the limit"),
        Event(now_ns - 38 * _SECOND, "alert", "source", "WARNING star.starboard rejected <8.1 σ>"),
        Event(now_ns - 190 * _SECOND, "mode", "pointing", "ONE_LIGHT → TWO_LIGHTS"),
    )
    return state_with_mounting_shift(
        utc_ns=now_ns, sources=(bad, good, source("lights")), alerts=None, inputs=tuple(inputs), events=events
    )


def _innovations(rng: np.random.Generator, name: str, length_s: float) -> list[InnovationPoint]:
    axes = ("x", "z") if name == "lights" else ("up", "right")
    points = []
    for at_s in np.arange(-length_s, 0.0, 0.5):
        if name != "lights" and NO_STARS_S[0] < at_s < NO_STARS_S[1]:
            continue
        is_shifted = name == "star.starboard" and at_s > -SHIFT_AGE_S
        mean = rng.normal(0.0, 3.0, 2) + (np.array([-1.8, SHIFT_RIGHT_ARCSEC]) if is_shifted else 0.0)
        points.append(
            InnovationPoint(
                NOW_NS + int(at_s * 1e9),
                axes,
                mean * ARCSEC,
                np.full(2, 3.0 * ARCSEC),
                not is_shifted,
            )
        )
    return points


def _errors(rng: np.random.Generator, at_s: np.ndarray, sigma: dict[str, float], has_truth: bool) -> list[ErrorPoint]:
    known = 1.0 if has_truth else np.nan
    points = []
    error = dict.fromkeys(sigma, 0.0)
    for at_second in at_s:
        error = {name: 0.8 * error[name] + 0.6 * rng.normal(0.0, sigma[name]) for name in sigma}
        grown = {
            name: value * (3.0 if NO_STARS_S[0] < at_second < NO_STARS_S[1] else 1.0) for name, value in sigma.items()
        }
        known_error = {name: known * value for name, value in error.items()}
        points.append(ErrorPoint(NOW_NS + int(at_second * 1e9), known_error, grown))
    return points


def _budget_point(at_second: float) -> BudgetPoint:
    no_stars = NO_STARS_S[0] < at_second < NO_STARS_S[1]
    part = {
        "ins_noise": 1.19,
        "ins_drift": 5.2 if no_stars else 0.9 if at_second < -SHIFT_AGE_S else 1.42,
        "star_noise": 0.6 if at_second < -SHIFT_AGE_S else 1.06,
        "installation": 0.37 + 0.9 * np.exp(-(at_second + 600.0) / 150.0),
        "ship_position": 0.11,
        "refraction": 0.08,
        "earth_rotation": 0.01,
    }
    of_angle = {name: (value * ARCSEC) ** 2 for name, value in part.items()}
    by_angle = {"heading": of_angle, "pitch": of_angle, "roll": {name: 2.0 * value for name, value in of_angle.items()}}
    return BudgetPoint(NOW_NS + int(at_second * 1e9), by_angle)


def _beacon_points(rng: np.random.Generator, x: float, z: float) -> list[BeaconPoint]:
    points = []
    for at_s in np.arange(-90.0, 0.0, 0.5):
        off = rng.normal(0.0, 1.5 * ARCSEC, 2)
        moved = 3e-4 * np.array([np.sin(at_s / 9.0), np.cos(at_s / 9.0)])
        points.append(
            BeaconPoint(NOW_NS + int(at_s * 1e9), x + moved[0], z + moved[1], float(off[0]), float(off[1]), True)
        )
    return points


def _star_residuals(
    rng: np.random.Generator, azimuth: float, elevation: float, right_arcsec: float = 0.0
) -> ExposurePoint:
    right = (right_arcsec + rng.normal(0.0, 4.0, 8)) * ARCSEC
    return ExposurePoint(
        utc_ns=NOW_NS,
        u=rng.uniform(60.0, 2000.0, 8),
        v=rng.uniform(60.0, 2000.0, 8),
        is_accepted=not right_arcsec,
        star_count=8,
        rejected_count=0,
        azimuth=azimuth,
        elevation=elevation,
        residual_right=right,
        residual_up=rng.normal(0.0, 4.0, 8) * ARCSEC,
    )
