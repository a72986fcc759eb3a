"""Sentences of common makers that pynmea2 supports partly or not at all, each with its manual and conventions.

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

import re

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
