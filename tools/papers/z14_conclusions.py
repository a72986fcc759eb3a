"""[Z14]'s fifteen conclusions, each tested with the exact model in each reading.

The conclusions are tested at the paper's operating point, over the sweeps of its six figures. A conclusion about one
layout is tested at this layout. Absolute values of the errors are compared. In figures 1 to 3, with one error, a trend
must be monotonic. In figures 4 to 6, with all six errors, two errors cause the trend. The four small errors, 3" + 3" +
1" + 1", are added with their signs: a trend may reverse by at most their sum.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_studies.layout.config import OperatingPoint
from ship_studies.layout.installation_model import (
    CURVE_AZIMUTHS_DEG,
    InstallationConvention,
    all_curves,
    linearise,
    point_angles_deg,
)
from tools.papers.z14_factors import ANGLES, exact_jacobian, random_attitudes

POINT = OperatingPoint()
HEADING, PITCH, ROLL = range(3)
AHEAD_ASTERN, ABEAM = (0.0, 180.0), (90.0, 270.0)
_ROUNDING_ARCSEC = 1e-9
_SMALL_ERRORS_ARCSEC = 8.0


@dataclass(frozen=True)
class Conclusion:
    """One conclusion of the paper.

    Attributes:
        place: section and number in the paper.
        words: content, in our words.
        holds: returns True if the conclusion holds in a reading.
        remark: remark on readings in which the conclusion does not hold.
    """

    place: str
    words: str
    holds: Callable[[InstallationConvention], bool]
    remark: str = ""


def curve_arcsec(figure: int, azimuth_deg: float | None, reading: InstallationConvention) -> FloatArray:
    """Return sizes of the errors of heading, pitch, roll in a figure, arcsec, shape (n, 3)."""
    (curve,) = (
        curve
        for curve in all_curves(POINT)
        if (curve.sweep.number, curve.azimuth_deg, curve.convention) == (figure, azimuth_deg, reading)
    )
    return np.abs(curve.errors_arcsec)


def of_star_roll(reading: InstallationConvention, **swept_deg: FloatArray | float) -> FloatArray:
    """Return sizes of heading, pitch, roll errors due to 100" about the boresight, arcsec, shape (n, 3).

    Angles in ``swept_deg`` replace angles of the operating point.
    """
    count = max(np.size(values) for values in swept_deg.values())
    angles_deg = np.tile(point_angles_deg(POINT, 0.0), (count, 1))
    for name, values in swept_deg.items():
        angles_deg[:, ANGLES.index(name)] = values
    angles = np.deg2rad(angles_deg)
    return np.abs(100.0 * linearise(angles[:, :3], angles[:, 3:], reading).star[:, :, 2])


def is_growing(sizes: FloatArray, turn_back_arcsec: float) -> bool:
    """True if the last size exceeds the first by more than the limit, and no decrease in between exceeds the limit."""
    turned_back = np.max(np.maximum.accumulate(sizes) - sizes)
    return bool(turned_back <= turn_back_arcsec and sizes[-1] - sizes[0] > turn_back_arcsec)


def is_falling(sizes: FloatArray, turn_back_arcsec: float) -> bool:
    """True if the last size is below the first by more than the limit, and no increase in between exceeds the limit."""
    return is_growing(sizes[::-1], turn_back_arcsec)


def is_falling_then_growing(sizes: FloatArray, turn_back_arcsec: float) -> bool:
    """True if sizes decrease to a minimum between the ends, and increase after the minimum."""
    least = int(np.argmin(sizes))
    return is_falling(sizes[: least + 1], turn_back_arcsec) and is_growing(sizes[least:], turn_back_arcsec)


def is_oscillating(sizes: FloatArray) -> bool:
    """True if sizes over a full turn return to the initial value, and vary by more than the sum of the small errors."""
    return bool(np.ptp(sizes) > _SMALL_ERRORS_ARCSEC and abs(sizes[-1] - sizes[0]) < _ROUNDING_ARCSEC)


# -- section 3.1: an error of 100" about the boresight alone ------------------------------------------------------


def peak_of_heading_is_112(reading: InstallationConvention) -> bool:
    """Test over all installation azimuths."""
    peak = np.max(of_star_roll(reading, A0=np.arange(0.0, 360.0, 0.1))[:, HEADING])
    return bool(np.round(peak) == 112.0)


def flat_over_star_azimuth(reading: InstallationConvention) -> bool:
    """Test in figure 1."""
    return all(
        np.ptp(curve_arcsec(1, azimuth_deg, reading), axis=0).max() < _ROUNDING_ARCSEC
        for azimuth_deg in CURVE_AZIMUTHS_DEG
    )


def oscillates_over_es_roll_s_a0(reading: InstallationConvention) -> bool:
    """Test over a full turn of A0, and over full turns of Es and of γs at each of the four azimuths of the figures."""
    turn_deg = np.arange(0.0, 361.0) + 0.25  # no angle with a pitch of 90°
    by_a0 = of_star_roll(reading, A0=turn_deg)
    swept = [of_star_roll(reading, **{name: turn_deg, "A0": a0}) for name in ("Es", "γs") for a0 in CURVE_AZIMUTHS_DEG]
    return all(is_oscillating(sizes[:, angle]) for sizes in (by_a0, *swept) for angle in range(3))


def ahead_roll_and_abeam_heading(reading: InstallationConvention) -> bool:
    """Test at E0 = 35° that roll is worst ahead and astern, and heading abeam; test the trends over E0 in figure 3."""
    ahead = [curve_arcsec(3, azimuth_deg, reading) for azimuth_deg in AHEAD_ASTERN]
    abeam = [curve_arcsec(3, azimuth_deg, reading) for azimuth_deg in ABEAM]
    trends = [is_growing(sizes[:, angle], _ROUNDING_ARCSEC) for sizes in ahead for angle in (HEADING, PITCH)]
    trends += [is_growing(sizes[:, PITCH], _ROUNDING_ARCSEC) for sizes in abeam]
    trends += [is_falling(sizes[:, angle], _ROUNDING_ARCSEC) for sizes in abeam for angle in (HEADING, ROLL)]
    return worst_is(ROLL, AHEAD_ASTERN, reading) and worst_is(HEADING, ABEAM, reading) and all(trends)


def worst_is(angle: int, azimuths_deg: tuple[float, ...], reading: InstallationConvention) -> bool:
    """True if an angle of the ship has the largest error at E0 = 35°, at each of some azimuths."""
    return all(int(np.argmax(sizes)) == angle for sizes in of_star_roll(reading, A0=np.array(azimuths_deg)))


# -- section 3.2: all six errors ----------------------------------------------------------------------------------


def oscillates_over_installation_azimuth(reading: InstallationConvention) -> bool:
    """Test in figure 4."""
    return all(is_oscillating(curve_arcsec(4, None, reading)[:, angle]) for angle in range(3))


def flat_over_installation_roll(reading: InstallationConvention) -> bool:
    """Test in figure 5."""
    return all(
        np.ptp(curve_arcsec(5, azimuth_deg, reading), axis=0).max() < _ROUNDING_ARCSEC
        for azimuth_deg in CURVE_AZIMUTHS_DEG
    )


def pitch_grows_with_elevation(reading: InstallationConvention) -> bool:
    """Test in figure 6, at all four azimuths."""
    return all(_trend(is_growing, azimuth_deg, PITCH, reading) for azimuth_deg in CURVE_AZIMUTHS_DEG)


def ahead_heading_grows_roll_falls(reading: InstallationConvention) -> bool:
    """Test in figure 6, A0 = 0."""
    return _trend(is_growing, 0.0, HEADING, reading) and _trend(is_falling, 0.0, ROLL, reading)


def to_starboard_heading_and_roll_fall(reading: InstallationConvention) -> bool:
    """Test in figure 6, A0 = 90°."""
    return _trend(is_falling, 90.0, HEADING, reading) and _trend(is_falling, 90.0, ROLL, reading)


def astern_heading_grows_roll_falls_then_grows(reading: InstallationConvention) -> bool:
    """Test in figure 6, A0 = 180°."""
    return _trend(is_growing, 180.0, HEADING, reading) and _trend(is_falling_then_growing, 180.0, ROLL, reading)


def to_port_heading_falls_roll_falls_then_grows(reading: InstallationConvention) -> bool:
    """Test in figure 6, A0 = 270°."""
    return _trend(is_falling, 270.0, HEADING, reading) and _trend(is_falling_then_growing, 270.0, ROLL, reading)


def _trend(
    kind: Callable[[FloatArray, float], bool], azimuth_deg: float, angle: int, reading: InstallationConvention
) -> bool:
    return kind(curve_arcsec(6, azimuth_deg, reading)[:, angle], _SMALL_ERRORS_ARCSEC)


# -- section 3.3: the whole ---------------------------------------------------------------------------------------


def star_azimuth_moves_heading_alone(reading: InstallationConvention) -> bool:
    """Test at random attitudes that the factor is one, and that no factor depends on As."""
    return _moves_alone("As", HEADING, reading)


def installation_roll_moves_roll_alone(reading: InstallationConvention) -> bool:
    """Test at random attitudes that the factor is one, and that no factor depends on γ0."""
    return _moves_alone("γ0", ROLL, reading)


def _moves_alone(name: str, angle: int, reading: InstallationConvention) -> bool:
    angles = random_attitudes(200)
    moved = angles.copy()
    moved[:, ANGLES.index(name)] += 1.0
    factors, of_moved = (exact_jacobian(each, reading) for each in (angles, moved))
    steady = np.isfinite(factors[:, 0, 0]) & np.isfinite(of_moved[:, 0, 0])
    is_one = np.allclose(factors[steady, :, ANGLES.index(name)], np.eye(3)[angle], atol=1e-9)
    return bool(is_one and np.allclose(factors[steady], of_moved[steady], rtol=1e-6, atol=1e-9))


def along_the_keel_roll_abeam_heading(reading: InstallationConvention) -> bool:
    """Test at the operating point, E0 = 35°."""
    return worst_is(ROLL, AHEAD_ASTERN, reading) and worst_is(HEADING, ABEAM, reading)


def pitch_grows_and_the_others_depend_on_the_layout(reading: InstallationConvention) -> bool:
    """Test in figure 6: pitch grows at all azimuths; the changes of heading and roll differ between azimuths."""
    courses = [curve_arcsec(6, azimuth_deg, reading) for azimuth_deg in CURVE_AZIMUTHS_DEG]
    gains = np.array([course[-1] - course[0] for course in courses])
    differ = bool(np.all(np.ptp(gains[:, [HEADING, ROLL]], axis=0) > _SMALL_ERRORS_ARCSEC))
    return pitch_grows_with_elevation(reading) and differ


CONCLUSIONS = (
    Conclusion(
        "3.1 (1)", "an error of 100″ about the boresight causes up to 112″ of heading error", peak_of_heading_is_112,
        "185.75″ by (4); the paper's own figure 3 has 141″ at E0 = 0 for a sensor abeam",
    ),
    Conclusion("3.1 (2)", "nothing depends on As", flat_over_star_azimuth),
    Conclusion(
        "3.1 (3)", "all errors oscillate over Es, γs and A0", oscillates_over_es_roll_s_a0,
        "by (4) a sensor abeam causes no error of pitch at γs = 90°, for any Es",
    ),
    Conclusion(
        "3.1 (4)",
        "ahead and astern roll is worst, heading and pitch grow with E0; abeam heading is worst, pitch grows with E0, "
        "heading and roll fall", ahead_roll_and_abeam_heading,
        "by (4) the errors of a sensor abeam do not depend on E0: heading 141″, pitch 0, roll 100″",
    ),
    Conclusion("3.2 (1)", "all errors oscillate over A0", oscillates_over_installation_azimuth),
    Conclusion(
        "3.2 (2)", "nothing depends on γ0", flat_over_installation_roll,
        "by (4) the deck rotates with γ0 under a fixed sensor: ahead, the heading error changes from 273″ to −45″",
    ),
    Conclusion(
        "3.2 (3)", "pitch grows with E0", pitch_grows_with_elevation,
        "by (4) this holds for sensors ahead and astern; abeam the error stays below 4″",
    ),
    Conclusion("3.2 (4)", "ahead heading grows with E0, roll falls", ahead_heading_grows_roll_falls),
    Conclusion(
        "3.2 (5)", "to starboard heading and roll fall with E0", to_starboard_heading_and_roll_fall,
        "by (4) neither changes by more than 2″",
    ),
    Conclusion(
        "3.2 (6)", "astern heading grows with E0, roll falls and then grows",
        astern_heading_grows_roll_falls_then_grows,
        "by (4) roll falls to zero at 86° and then grows by only 3″, less than the small errors",
    ),
    Conclusion(
        "3.2 (7)", "to port heading falls with E0, roll falls and then grows",
        to_port_heading_falls_roll_falls_then_grows, "by (4) neither changes by more than 2″",
    ),
    Conclusion("3.3 (1)", "ΔAs changes only heading, by ΔAs; nothing depends on As", star_azimuth_moves_heading_alone),
    Conclusion(
        "3.3 (2)", "Δγ0 changes only roll, by Δγ0; nothing depends on γ0", installation_roll_moves_roll_alone,
        "by (4) Δγ0 has the same effect as −Δγs",
    ),
    Conclusion(
        "3.3 (3)", "Δγs causes mainly a roll error along the keel, mainly a heading error abeam",
        along_the_keel_roll_abeam_heading,
        "on a level ship: a sensor abeam then causes errors of heading (sin E0) and *pitch* (cos E0)",
    ),
    Conclusion(
        "3.3 (4)", "pitch grows with E0, heading and roll depend on the layout",
        pitch_grows_and_the_others_depend_on_the_layout, "see 3.2 (3)",
    ),
)  # fmt: skip
