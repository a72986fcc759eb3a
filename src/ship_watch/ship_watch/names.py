"""Limit of the number of names that are stored, because the network can deliver any number of names.

The first names are kept, so that further names never displace a known source.
"""

import logging
import time
from collections.abc import Collection
from typing import Any

MAX_NAMES = 256
"""Maximum number of names of one kind; a large suite has some tens."""

MAX_NAME_LENGTH = 256
"""Maximum length of a name, characters."""

_LINE_PERIOD_S = 600.0
_logged_s: dict[str, float] = {}


def has_room(names: Collection[Any], name: Any, kind: str, max_names: int = MAX_NAMES) -> bool:
    """True if a name is stored already or may be added; otherwise a warning is logged.

    The warning is logged at most once in ten minutes for each ``kind``.

    Args:
        names: stored names.
        name: a text, or a tuple of texts.
        kind: kind of the names, for the warning.
        max_names: maximum number of names.
    """
    if name in names:
        return True
    length = len(name) if isinstance(name, str) else sum(map(len, name))
    if len(names) < max_names and length <= MAX_NAME_LENGTH:
        return True
    now_s = time.monotonic()
    if now_s - _logged_s.get(kind, -_LINE_PERIOD_S) >= _LINE_PERIOD_S:
        _logged_s[kind] = now_s
        why = (
            f"limit of {len(names)} names reached"
            if len(names) >= max_names
            else f"name too long ({length} characters)"
        )
        logging.getLogger(__name__).warning(f"{kind} {str(name)[:60]!r} and others are not shown: {why}")
    return False
