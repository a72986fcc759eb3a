"""An attitude as sentences: HDT, THS, ROT, PASHR, PSXN 20 and 23.

Signs of all of them are those of the suite: heading clockwise from true North, pitch positive with the bow up, roll
positive with the starboard side down, which is "port side up" in Kongsberg's Seapath manual (PSXN) and what Trimble and
NovAtel print (PASHR). A rate of turn is negative where the bow turns to port. Where there is no attitude the fields are
void and the status says so: no sentence repeats an old value. Heave, which the suite does not know, is void.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

import pynmea2

from ship_bags.nmea.sentences import THS
from ship_geometry.frames import SINGULAR_ELEVATION
from ship_nmea.sentences.defined import time_field

_NAN3 = (math.nan, math.nan, math.nan)
_FULL_TURN_DEG = 360
_S_PER_MIN = 60.0
_TIME_DECIMALS = 3
_BELOW_ROUNDING = 1.0 - 1e-12
"""What floating point adds to a number of units must not be rounded up to one more."""


class Worth(Enum):
    """What an attitude is worth: mode of THS, and quality of PSXN 20 (0 normal, 1 reduced, 2 invalid)."""

    NORMAL = "A", 0
    ESTIMATED = "E", 1
    """Held by part of the sources: COASTING without recent stars, DEGRADED."""
    SIMULATED = "S", 1
    """Played or simulated: the node follows /clock."""
    VOID = "V", 2

    @property
    def mode(self) -> str:
        """Mode of THS."""
        return self.value[0]

    @property
    def quality(self) -> int:
        """Quality of PSXN 20."""
        return self.value[1]


@dataclass(frozen=True)
class AttitudeToTell:
    """An attitude as the sentences need it.

    Attributes:
        time_ns: when it is valid, POSIX UTC; of a void one, when that is told.
        worth: what it is worth.
        angles: heading, pitch, roll, rad; NaN = void.
        sigmas: standard deviation of each, rad; NaN = unknown.
        heading_rate: clockwise, rad/s; NaN = unknown.
    """

    time_ns: int
    worth: Worth = Worth.VOID
    angles: tuple[float, float, float] = _NAN3
    sigmas: tuple[float, float, float] = _NAN3
    heading_rate: float = math.nan


def heading_rate(pitch: float, roll: float, rate_flu: tuple[float, float, float]) -> float:
    """How fast the heading turns clockwise, rad/s; NaN where the bow points to the zenith and there is no heading.

    Args:
        pitch: bow up positive, rad.
        roll: starboard down positive, rad.
        rate_flu: angular velocity of the deck against the horizon in its (forward, left, up), right-handed, rad/s.

    Example:
        >>> heading_rate(0.0, 0.0, (0.0, 0.0, -0.01))  # turning to starboard
        0.01
    """
    if not abs(pitch) < SINGULAR_ELEVATION:
        return math.nan
    _, left, up = rate_flu
    return -(left * math.sin(roll) + up * math.cos(roll)) / math.cos(pitch)


def hdt(attitude: AttitudeToTell, talker: str, decimals: int) -> pynmea2.NMEASentence:
    """Heading, true. It has no status: where there is no heading the field is void."""
    return pynmea2.HDT(talker, "HDT", (_heading(attitude.angles[0], decimals), "T"))


def ths(attitude: AttitudeToTell, talker: str, decimals: int) -> pynmea2.NMEASentence:
    """True heading and status."""
    return THS(talker, "THS", (_heading(attitude.angles[0], decimals), attitude.worth.mode))


def rot(attitude: AttitudeToTell, talker: str, decimals: int) -> pynmea2.NMEASentence:
    """Rate of turn, °/min; V where it is not known."""
    rate = _signed(attitude.heading_rate * _S_PER_MIN, decimals)
    return pynmea2.ROT(talker, "ROT", (rate, "A" if rate else "V"))


def pashr(attitude: AttitudeToTell, _talker: str, decimals: int) -> pynmea2.NMEASentence:
    """Time, heading, roll, pitch, and the standard deviation of each with one decimal more, never rounded to zero.

    The last two fields say 1 where an attitude is told, otherwise 0: "position" and "after alignment" at NovAtel.
    """
    heading, pitch, roll = attitude.angles
    is_told = str(int(attitude.worth is not Worth.VOID))
    sigma_heading, sigma_pitch, sigma_roll = (_accuracy(sigma, decimals + 1) for sigma in attitude.sigmas)
    heading_text = _heading(heading, decimals)
    angles = _signed(roll, decimals, "+"), _signed(pitch, decimals, "+")
    data = (time_field(attitude.time_ns, _TIME_DECIMALS), heading_text, "T" if heading_text else "", *angles, "")
    return pynmea2.ash.ASHRATT("ASH", ("R", *data, sigma_roll, sigma_pitch, sigma_heading, is_told, is_told))


def psxn20(attitude: AttitudeToTell, _talker: str, _decimals: int) -> pynmea2.NMEASentence:
    """Quality of position, height, heading, roll and pitch; of position and height, which we do not tell, invalid."""
    quality = str(attitude.worth.quality)
    invalid = str(Worth.VOID.quality)
    return pynmea2.sxn.SXN20("SXN", ("", "20", invalid, invalid, quality, quality))


def psxn23(attitude: AttitudeToTell, _talker: str, decimals: int) -> pynmea2.NMEASentence:
    """Roll, pitch, heading."""
    heading, pitch, roll = attitude.angles
    angles = _signed(roll, decimals), _signed(pitch, decimals), _heading(heading, decimals)
    return pynmea2.sxn.SXN23("SXN", ("", "23", *angles, ""))


ATTITUDE_SENTENCES: dict[str, Callable[[AttitudeToTell, str, int], Any]] = {
    "HDT": hdt, "THS": ths, "ROT": rot, "PASHR": pashr, "PSXN20": psxn20, "PSXN23": psxn23,
}  # fmt: skip
"""Name → what makes it of an attitude, the talker's two letters, and how many decimals its angles have."""
SAY_SIMULATED = ("THS",)
"""The sentences that can say of themselves that they are simulated."""


def as_played(name: str, attitude: AttitudeToTell) -> AttitudeToTell:
    """What a sentence may tell of a played attitude without passing for live: void, unless it says what it is."""
    return attitude if name in SAY_SIMULATED else AttitudeToTell(attitude.time_ns)


def _heading(angle: float, decimals: int) -> str:
    """From 0 to below 360: what would be rounded to 360 is 0."""
    if not math.isfinite(angle):
        return ""
    unit = 10**decimals
    return f"{round(math.degrees(angle) * unit) % (_FULL_TURN_DEG * unit) / unit:.{decimals}f}"


def _signed(angle: float, decimals: int, sign: str = "-") -> str:
    """With a sign where it is negative, or always where ``sign`` is ``+``; zero has no minus."""
    if not math.isfinite(angle):
        return ""
    # Zero is added because round() gives a negative one for small negative numbers.
    return f"{round(math.degrees(angle), decimals) + 0.0:{sign}.{decimals}f}"


def _accuracy(sigma: float, decimals: int) -> str:
    """Rounded up to the last decimal."""
    if not math.isfinite(sigma):
        return ""
    unit = 10**decimals
    return f"{max(1, math.ceil(math.degrees(sigma) * unit * _BELOW_ROUNDING)) / unit:.{decimals}f}"
