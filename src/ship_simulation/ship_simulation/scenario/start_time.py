"""The start of a scenario as POSIX nanoseconds."""

import re
from datetime import datetime, timezone

_SECOND_NS = 1_000_000_000
_MOMENT = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?Z")


def start_of(start_utc: str) -> int:
    """POSIX nanoseconds of a moment such as ``2014-07-09T11:50:07.8Z``.

    Raises:
        ValueError: it is no such moment.
    """
    found = _MOMENT.fullmatch(start_utc)
    if found is None:
        raise ValueError("expected YYYY-MM-DDThh:mm:ss, at most nine decimals, and the letter Z")
    whole = datetime.fromisoformat(found[1]).replace(tzinfo=timezone.utc)
    return round(whole.timestamp()) * _SECOND_NS + int(f"{found[2] or '0':0<9}")
