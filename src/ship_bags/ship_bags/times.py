"""Times as people read them."""

from datetime import datetime, timezone

NS_PER_S = 1_000_000_000


def utc_text(time_ns: int) -> str:
    """A POSIX time in nanoseconds as UTC with milliseconds, e.g. ``2014-08-01T00:00:00.170Z``."""
    seconds, remainder_ns = divmod(time_ns, NS_PER_S)
    try:
        moment = datetime.fromtimestamp(seconds, tz=timezone.utc)
    except (ValueError, OverflowError, OSError):
        return f"{time_ns} ns"
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{remainder_ns // 1_000_000:03d}Z"
