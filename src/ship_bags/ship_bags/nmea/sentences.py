"""Parsing of one line of an instrument: an NMEA 0183 sentence, or a line ``MET`` of a mast.

Sentences are parsed by pynmea2. This module adds THS, PASHR with a time of any precision, MET, which is not NMEA, and
the dialects. These are sentences of common makers that pynmea2 supports partly or not at all, each with its manual and
conventions.

========== ========================================================================================================
PRDID      Teledyne RD Instruments; also sent by POS MV: Applanix, POS MV V5 Installation and Operation Guide, table 21.
           Signs: QPS driver manual, "NMEA PRDID (R-P)": roll positive to starboard, pitch positive bow up. No time.
           The angles of POS MV are Tait-Bryan angles unless POS MV is set to PRDID-TSS.
PTNTHPR    Honeywell HMR3000 User's Guide, sections 3.10 and 3.12, and compasses of True North Technologies. Letters:
           N normal, M and O low and high warning; values with L, P (alarm) or C (tuning) are not used. Angles without a
           decimal point are mils of a compass in mil mode. No time.
PSAT,HPR   Hemisphere GNSS (CSI Wireless), DGPS MAX Programming Manual, section 2.14: N heading by GNSS, G by the gyro.
           The time is UTC in the format notes of NOAA's R/V Ronald H. Brown (CLIVAR 2010), "GPS time" in the manual.
           The manuals of PTNTHPR and PSAT,HPR state no signs; pitch is taken as positive bow up, roll starboard down.
ROT        IEC 61162-1: rate of turn, °/min, negative to port; with HDT in one burst of a gyrocompass.
========== ========================================================================================================
"""

import math
import re
from dataclasses import dataclass
from datetime import time
from decimal import Decimal
from typing import Any

import pynmea2

_NUMBER, _WITH_POINT = r"[+-]?\d+(\.\d*)?", r"[+-]?\d+\.\d+"
_TIME = r"([01]\d|2[0-3])[0-5]\d[0-5]\d(\.\d+)?"
_WITHOUT_ALARM = "[MNO]"

DIALECTS: dict[str, tuple[tuple[str, str], ...]] = {
    "PRDID": (("pitch", _NUMBER), ("roll", _NUMBER), ("true_heading", _NUMBER)),
    "PTNTHPR": (
        ("true_heading", _WITH_POINT), ("status", _WITHOUT_ALARM), ("pitch", _WITH_POINT), ("status", _WITHOUT_ALARM),
        ("roll", _WITH_POINT), ("status", _WITHOUT_ALARM),
    ),
    "PSAT,HPR": (
        ("timestamp", _TIME), ("true_heading", _NUMBER), ("pitch", _NUMBER), ("roll", _NUMBER), ("status", "[NG]"),
    ),
    "ROT": (("rate_of_turn", _NUMBER), ("status", "A")),
}  # fmt: skip
"""Kind → name of each field and its valid form."""

ATTITUDES = ("PRDID", "PTNTHPR", "PSAT,HPR")


BAD_CHECKSUM, UNPARSED = "checksum failed", "unparsed"
UNKNOWN, VOID, OUT_OF_RANGE = "unknown sentence", "no values in it", "angle out of range"
INCOMPLETE_POSITION = "GGA with an incomplete position (N, S, E or W, or a coordinate missing)"
WRONG_MINUTES, WRONG_POSITION = "GGA with 60 minutes or more", "GGA beyond 90° of latitude or 180° of longitude"
"""Details of an unparsed line: unknown to pynmea2, without values, or with impossible values."""

# Fields of the line MET of the station mwx1.
_MET_TEMPERATURE, _MET_HUMIDITY, _MET_PRESSURE = 3, 4, -1
_MET_LEAST_FIELDS = 6

_PASHR_LEAST_FIELDS = 6
"""Minimum number of fields of a PASHR: all up to the pitch."""

_PA_PER_BAR = 1e5

AUTONOMOUS = "A"
"""Mode of THS with a measured heading; in all other modes the heading is estimated, manual, simulated or invalid."""

_REQUIRED_FIELDS = {
    "ZDA": ("timestamp", "day", "month", "year"),
    "GGA": ("timestamp",),
    "HDT": ("heading",),
    "THS": ("heading",),
    "SXN20": ("head_qual", "rp_qual"),
    "SXN23": ("roll", "pitch", "head"),
    "ASHRATT": ("timestamp", "true_heading", "roll", "pitch"),
    "MDA": (),
    "XDR": (),
}
"""Name of a class of pynmea2 → required fields."""

_RANGES_DEG = {
    "heading": (0.0, 360.0), "head": (0.0, 360.0), "true_heading": (0.0, 360.0), "pitch": (-90.0, 90.0),
    "roll": (-180.0, 180.0),
}  # fmt: skip
"""Valid ranges of angles, degrees; some instruments write 999.99 for an unknown value."""

_NO_NUMBERS = ("timestamp", "status")
"""Fields of dialects that are not numbers."""

_KINDS = {"SXN20": "PSXN20", "SXN23": "PSXN23", "ASHRATT": "PASHR"}

_TIME_OF_DAY = re.compile(r"\d{6}(\.\d+)?", re.ASCII)
_LATITUDE, _LONGITUDE = (re.compile(rf"\d{{3,{most}}}(\.\d*)?", re.ASCII) for most in (4, 5))
_MINUTES = 60.0
"""Minutes of a degree."""


class THS(pynmea2.TalkerSentence):  # type: ignore[misc]
    """True heading with its status (IEC 61162-1): A autonomous, V invalid; pynmea2 finds this class by its name."""

    fields = (("True heading, degrees", "heading", float), ("Mode indicator", "mode"))


@dataclass(frozen=True)
class Sentence:
    """Parsed sentence.

    Attributes:
        kind: ``ZDA``, ``GGA``, ``HDT``, ``THS``, ``PSXN20``, ``PSXN23``, ``PASHR``, ``XDR``, ``MDA`` or ``MET``, or a
            key of :data:`ship_bags.nmea.sentences.DIALECTS`.
        content: :class:`MetReading` for MDA and MET, :class:`DialectContent` for dialects, else the sentence of
            pynmea2.
    """

    kind: str
    content: Any


@dataclass(frozen=True)
class NotOfInterest:
    """Known line that is not used."""

    name: str


@dataclass(frozen=True)
class Unusable:
    """Unusable line; ``detail`` is a more specific reason, empty if unknown."""

    reason: str
    detail: str = ""


@dataclass(frozen=True)
class MetReading:
    """Air at the mast: temperature in °C, relative humidity from 0 to 1, pressure in Pa; None if not given."""

    temperature_c: float | None = None
    humidity: float | None = None
    pressure_pa: float | None = None


@dataclass(frozen=True)
class DialectContent:
    """Content of a dialect's sentence: angles in degrees, a rate in °/min; None for a missing value."""

    text: str
    timestamp: time | None = None
    true_heading: float | None = None
    pitch: float | None = None
    roll: float | None = None
    rate_of_turn: float | None = None

    def __str__(self) -> str:
        """Return the sentence."""
        return self.text


def read_sentence(text: str) -> Sentence | NotOfInterest | Unusable:
    """Parse a text that begins with a sentence."""
    name = text.split(",")[0]
    if name == "MET":
        reading = _met_reading(text)
        return Unusable(UNPARSED) if reading is None else Sentence(name, reading)
    if not name.startswith("$"):
        known_shape = name.isalpha() and name.isupper() and "," in text
        return NotOfInterest(name) if known_shape else Unusable(UNPARSED)
    try:
        content = pynmea2.parse(text)
    except pynmea2.ChecksumError:
        return Unusable(BAD_CHECKSUM)
    except pynmea2.SentenceTypeError:
        return Unusable(UNPARSED, UNKNOWN)
    except Exception:
        # For truncated sentences pynmea2 raises IndexError and other undeclared exceptions.
        return Unusable(UNPARSED)
    if kind := dialect_of(text):
        return _dialect(kind, text)
    return _select_sentence(name.lstrip("$"), _pashr(content) if type(content).__name__ == "ASH" else content)


def _dialect(kind: str, text: str) -> Sentence | NotOfInterest | Unusable:
    """Return a dialect's sentence; if a field is unusable, NotOfInterest for ROT and Unusable for other kinds."""
    fields = dialect_fields(kind, text)
    if kind == "ROT" and (fields is None or not all(fields.values())):
        return NotOfInterest(text.split(",")[0].lstrip("$"))
    if fields is None:
        return Unusable(UNPARSED, f"{kind}: a field or its status cannot be used")
    if not all(fields.values()):
        return Unusable(UNPARSED, VOID)
    values: dict[str, Any] = {name: float(field) for name, field in fields.items() if name not in _NO_NUMBERS}
    if "timestamp" in fields:
        values["timestamp"] = pynmea2.nmea_utils.timestamp(fields["timestamp"])
    if any(not _is_in_range(name, value) for name, value in values.items()):
        return Unusable(UNPARSED, OUT_OF_RANGE)
    return Sentence(kind, DialectContent(text, **values))


def dialect_of(text: str) -> str | None:
    """Return the key of a sentence in :data:`DIALECTS`; None for other sentences."""
    name, _, rest = text.lstrip("$").partition(",")
    kind = name if name.startswith("P") else name[2:]
    subtype = f"{name},{rest.partition(',')[0]}"
    return next((known for known in (kind, subtype) if known in DIALECTS), None)


def dialect_fields(kind: str, text: str) -> dict[str, str] | None:
    """Return the fields of a sentence by name, empty text for an empty field; None if a field is missing or invalid."""
    row = DIALECTS[kind]
    fields = text.partition("*")[0].split(",")[1 + kind.count(",") :]
    if len(fields) < len(row):
        return None
    found = dict(zip((name for name, _ in row), fields, strict=False))
    is_of_form = all(
        not field or re.fullmatch(form, field, re.ASCII) for (_, form), field in zip(row, fields, strict=False)
    )
    return found if is_of_form else None


def _pashr(content: Any) -> Any:
    """Return the attitude of a PASHR with a time of any precision; return a PASHR of another form unchanged."""
    data = list(content.data)
    if len(data) < _PASHR_LEAST_FIELDS or not _TIME_OF_DAY.fullmatch(data[1]):
        return content
    attitude = pynmea2.ash.ASHRATT("ASH", [data[0], f"{data[1][:6]}.00", *data[2:]])
    attitude.data[1] = data[1]
    return attitude


def _select_sentence(name: str, content: Any) -> Sentence | NotOfInterest | Unusable:
    """Return the sentence if its kind is used, the sentence is complete, and its fields are numbers."""
    kind = type(content).__name__
    if kind not in _REQUIRED_FIELDS:
        # PSXN sentences differ by a number after the name, which pynmea2 puts into its class name.
        return NotOfInterest(name + kind.removeprefix("SXN") if "SXN" in kind else name)
    # pynmea2 returns the text of a field that is not a number.
    # A THS with an invalid mode may have no heading.
    needed = () if kind == "THS" and content.mode not in ("", AUTONOMOUS) else _REQUIRED_FIELDS[kind]
    values = [getattr(content, field) for field in needed]
    if any(value is None for value in values):
        return Unusable(UNPARSED, VOID)
    if any(isinstance(value, str) or not _is_finite(value) for value in values):
        return Unusable(UNPARSED)
    if any(not _is_in_range(field, value) for field, value in zip(needed, values, strict=True)):
        return Unusable(UNPARSED, OUT_OF_RANGE)
    if kind == "ZDA" and not 1970 < content.year < 2038:
        return Unusable("year out of range")
    if kind == "GGA" and (problem := _position_problem(content)):
        return problem
    return Sentence(_KINDS.get(kind, kind), _mda_reading(content) if kind == "MDA" else content)


def _is_finite(value: Any) -> bool:
    """False for NaN and infinity, as of the field ``nan``; times of day are finite."""
    return not isinstance(value, (float, Decimal)) or number(value) is not None


def _is_in_range(field: str, value: Any) -> bool:
    """False for an angle outside its range; other fields have no range."""
    least, most = _RANGES_DEG.get(field, (None, None))
    return least is None or most is None or least <= float(value) <= most


def _position_problem(gga: Any) -> Unusable | None:
    """Return why the position of a GGA cannot be used; None for a usable or empty position."""
    parts = (gga.lat, gga.lat_dir, gga.lon, gga.lon_dir)
    if not any(parts):
        return None
    if not all(parts) or gga.lat_dir not in "NS" or gga.lon_dir not in "EW":
        return Unusable(UNPARSED, INCOMPLETE_POSITION)
    if not (_LATITUDE.fullmatch(gga.lat) and _LONGITUDE.fullmatch(gga.lon)):
        return Unusable(UNPARSED)
    if not (float(gga.lat) % 100.0 < _MINUTES and float(gga.lon) % 100.0 < _MINUTES):
        return Unusable(UNPARSED, WRONG_MINUTES)
    if not (abs(gga.latitude) <= 90.0 and abs(gga.longitude) <= 180.0):
        return Unusable(UNPARSED, WRONG_POSITION)
    return None


def _met_reading(sentence: str) -> MetReading | None:
    fields = sentence.split(",")
    if len(fields) < _MET_LEAST_FIELDS:
        return None
    try:
        return MetReading(
            temperature_c=float(fields[_MET_TEMPERATURE]),
            humidity=float(fields[_MET_HUMIDITY]) / 100.0,
            pressure_pa=float(fields[_MET_PRESSURE]) * 100.0,
        )
    except ValueError:
        return None


def _mda_reading(mda: Any) -> MetReading:
    """Return the air data of an MDA, which states bar, °C and per cent; None for a field that is not a number."""
    temperature_c, percent, bar = (number(v) for v in (mda.air_temp, mda.rel_humidity, mda.b_pressure_bar))
    return MetReading(
        temperature_c=temperature_c,
        humidity=None if percent is None else percent / 100.0,
        pressure_pa=None if bar is None else bar * _PA_PER_BAR,
    )


def number(value: Any) -> float | None:
    """Return a field as a finite number; None if the field is not such a number."""
    try:
        result = float(value)
    except (TypeError, ValueError):
        return None
    return result if math.isfinite(result) else None
