"""An attitude as sentences: HDT, THS, ROT, PASHR, PSXN 20 and 23.

All signs are as in the suite: heading clockwise from true North, pitch positive with the bow up, roll
positive with the starboard side down. Kongsberg's Seapath manual (PSXN) calls this roll "port side up"; the manuals of
Trimble and NovAtel (PASHR) have the same sign. A rate of turn is negative if the bow turns to port. Without an
attitude the fields are void and the status is invalid: no sentence repeats an old value. Heave, which the suite does
not estimate, is void.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

import pynmea2

from ship_bags.nmea.sentences import THS
from ship_geometry.frames import SINGULAR_ELEVATION
from ship_nmea.sentences.alerts import time_field

_NAN3 = (math.nan, math.nan, math.nan)
_FULL_TURN_DEG = 360
_S_PER_MIN = 60.0
_TIME_DECIMALS = 3
_ROUNDING_MARGIN = 1.0 - 1e-12
"""Factor before rounding up, so that a whole number of units with a floating-point error is not rounded up."""

SIMULATION_SENTENCES = ("THS",)
"""Sentences with a mode for simulated data."""


class AttitudeQuality(Enum):
    """Quality of an attitude, as mode of THS and as quality of PSXN 20 (0 normal, 1 reduced, 2 invalid)."""

    NORMAL = "A", 0
    ESTIMATED = "E", 1
    """COASTING or DEGRADED."""
    SIMULATED = "S", 1
    """Played or simulated: the node follows /clock."""
    VOID = "V", 2

    @property
    def ths_mode(self) -> str:
        """Return the mode of THS."""
        return self.value[0]

    @property
    def psxn_quality(self) -> int:
        """Return the quality of PSXN 20."""
        return self.value[1]


@dataclass(frozen=True)
class SentenceAttitude:
    """An attitude with the values of its sentences.

    Attributes:
        time_ns: time of validity, POSIX UTC, ns; for a void attitude, the time of sending.
        quality: quality of the attitude.
        angles: heading, pitch, roll, rad; NaN = void.
        sigmas: standard deviations of the angles, rad; NaN = unknown.
        heading_rate: clockwise rate of the heading, rad/s; NaN = unknown.
    """

    time_ns: int
    quality: AttitudeQuality = AttitudeQuality.VOID
    angles: tuple[float, float, float] = _NAN3
    sigmas: tuple[float, float, float] = _NAN3
    heading_rate: float = math.nan


def heading_rate(pitch: float, roll: float, rate_flu: tuple[float, float, float]) -> float:
    """Return the clockwise rate of the heading, rad/s; NaN if the pitch is ±89.9° or steeper, or unknown.

    Args:
        pitch: pitch, bow up positive, rad.
        roll: roll, starboard down positive, rad.
        rate_flu: angular velocity of the deck relative to the horizon, in deck axes forward, left, up, rad/s.

    Example:
        >>> heading_rate(0.0, 0.0, (0.0, 0.0, -0.01))  # turning to starboard
        0.01
    """
    if not abs(pitch) < SINGULAR_ELEVATION:
        return math.nan
    _, left, up = rate_flu
    return -(left * math.sin(roll) + up * math.cos(roll)) / math.cos(pitch)


def hdt(attitude: SentenceAttitude, talker: str, decimals: int) -> pynmea2.NMEASentence:
    """Return the true heading. HDT has no status: without a heading its field is void."""
    return pynmea2.HDT(talker, "HDT", (_heading_text(attitude.angles[0], decimals), "T"))


def ths(attitude: SentenceAttitude, talker: str, decimals: int) -> pynmea2.NMEASentence:
    """Return true heading and status."""
    return THS(talker, "THS", (_heading_text(attitude.angles[0], decimals), attitude.quality.ths_mode))


def rot(attitude: SentenceAttitude, talker: str, decimals: int) -> pynmea2.NMEASentence:
    """Return the rate of turn, °/min, with status V if the rate is unknown."""
    rate = _signed_text(attitude.heading_rate * _S_PER_MIN, decimals)
    return pynmea2.ROT(talker, "ROT", (rate, "A" if rate else "V"))


def pashr(attitude: SentenceAttitude, _talker: str, decimals: int) -> pynmea2.NMEASentence:
    """Return time, heading, roll, pitch, and sigmas of the angles, which have one more decimal and are never zero.

    The last two fields are 1 if there is an attitude, otherwise 0. NovAtel calls these fields "position" and "after
    alignment".
    """
    heading, pitch, roll = attitude.angles
    is_valid = str(int(attitude.quality is not AttitudeQuality.VOID))
    sigma_heading, sigma_pitch, sigma_roll = (_sigma_text(sigma, decimals + 1) for sigma in attitude.sigmas)
    heading_text = _heading_text(heading, decimals)
    angles = _signed_text(roll, decimals, "+"), _signed_text(pitch, decimals, "+")
    data = (time_field(attitude.time_ns, _TIME_DECIMALS), heading_text, "T" if heading_text else "", *angles, "")
    return pynmea2.ash.ASHRATT("ASH", ("R", *data, sigma_roll, sigma_pitch, sigma_heading, is_valid, is_valid))


def psxn20(attitude: SentenceAttitude, _talker: str, _decimals: int) -> pynmea2.NMEASentence:
    """Return the quality of position, height, heading, roll and pitch; position and height are not sent and invalid."""
    quality = str(attitude.quality.psxn_quality)
    invalid = str(AttitudeQuality.VOID.psxn_quality)
    return pynmea2.sxn.SXN20("SXN", ("", "20", invalid, invalid, quality, quality))


def psxn23(attitude: SentenceAttitude, _talker: str, decimals: int) -> pynmea2.NMEASentence:
    """Return roll, pitch, heading."""
    heading, pitch, roll = attitude.angles
    angles = _signed_text(roll, decimals), _signed_text(pitch, decimals), _heading_text(heading, decimals)
    return pynmea2.sxn.SXN23("SXN", ("", "23", *angles, ""))


ATTITUDE_SENTENCES: dict[str, Callable[[SentenceAttitude, str, int], Any]] = {
    "HDT": hdt, "THS": ths, "ROT": rot, "PASHR": pashr, "PSXN20": psxn20, "PSXN23": psxn23,
}  # fmt: skip
"""Name → function that returns the sentence of an attitude, a talker (two letters) and a number of decimals."""


def simulated_attitude(name: str, attitude: SentenceAttitude) -> SentenceAttitude:
    """Return a played attitude for a sentence; it is void unless the sentence has a mode for simulated data."""
    return attitude if name in SIMULATION_SENTENCES else SentenceAttitude(attitude.time_ns)


def _heading_text(angle: float, decimals: int) -> str:
    """Return a heading from 0 to below 360°; a value that would be rounded to 360 becomes 0."""
    if not math.isfinite(angle):
        return ""
    unit = 10**decimals
    return f"{round(math.degrees(angle) * unit) % (_FULL_TURN_DEG * unit) / unit:.{decimals}f}"


def _signed_text(angle: float, decimals: int, sign: str = "-") -> str:
    """Return an angle, °, with a sign if it is negative, or always if ``sign`` is ``+``; zero is never negative."""
    if not math.isfinite(angle):
        return ""
    # 0.0 is added because round() returns -0.0 for small negative numbers.
    return f"{round(math.degrees(angle), decimals) + 0.0:{sign}.{decimals}f}"


def _sigma_text(sigma: float, decimals: int) -> str:
    """Return a standard deviation, °, rounded up to the last decimal."""
    if not math.isfinite(sigma):
        return ""
    unit = 10**decimals
    return f"{max(1, math.ceil(math.degrees(sigma) * unit * _ROUNDING_MARGIN)) / unit:.{decimals}f}"
