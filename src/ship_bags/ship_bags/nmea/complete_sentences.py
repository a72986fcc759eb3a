"""Check that a sentence without a checksum is complete, by the number and the form of its fields.

A truncated heading looks valid: ``$HEHDT,21`` may be the beginning of ``$HEHDT,218.0,T``. Therefore a sentence without
a checksum is used only if its kind has an end that a truncated sentence lacks.
"""

import re

_NUMBER = r"[+-]?\d+(\.\d+)?"
_TIME = r"\d{6}(\.\d+)?"
_DIGIT, _HEAVE = r"\d", r"[+-]?\d+\.\d{2,}"
_SIGMA = f"({_NUMBER})?"

_FORMS: dict[str, tuple[str, ...]] = {
    "HDT": (_NUMBER, "T"),
    "THS": (f"({_NUMBER})?", "[A-Z]"),
    "ZDA": (_TIME, r"\d\d", r"\d\d", r"\d{4}", r"([+-]?\d\d)?", r"(\d\d)?"),
    "GGA": (
        _TIME, r"(\d{3,4}(\.\d+)?)?", "[NS]?", r"(\d{3,5}(\.\d+)?)?", "[EW]?", _DIGIT, r"(\d+)?", f"({_NUMBER})?",
        f"({_NUMBER})?", "M?", f"({_NUMBER})?", "M?", f"({_NUMBER})?", r"(\d{4})?",
    ),
    "PSXN20": ("20", _DIGIT, _DIGIT, _DIGIT, _DIGIT),
    "PSXN23": ("23", _NUMBER, _NUMBER, _NUMBER, _HEAVE),
    "PRDID": (_NUMBER, _NUMBER, r"\d{1,3}\.\d\d"),
    "PTNTHPR": (_NUMBER, "[A-Z]", _NUMBER, "[A-Z]", _NUMBER, "[A-Z]"),
    "PSAT,HPR": ("HPR", _TIME, _NUMBER, _NUMBER, _NUMBER, "[A-Z]"),
    "ROT": (_NUMBER, "A"),
    "PASHR": (
        _TIME, _NUMBER, "T", _NUMBER, _NUMBER, f"({_NUMBER})?", _SIGMA, _SIGMA, _SIGMA, _DIGIT, _DIGIT,
    ),
}  # fmt: skip
"""Kind of a sentence → form of each field after the name; without MDA and XDR, whose last fields may be void."""

_PATTERNS = {kind: re.compile(",".join(forms), re.ASCII) for kind, forms in _FORMS.items()}


def is_complete(kind: str, text: str) -> bool:
    """Return True if a sentence without a checksum has all fields of its kind in their forms; False for other kinds."""
    pattern = _PATTERNS.get(kind)
    return pattern is not None and bool(pattern.fullmatch(text.partition(",")[2]))
