"""The bound of what is kept by name: names come from the network, where anybody can invent more without end.

Those that come first are kept, so that no flood of names displaces a source that is known.
"""

import logging
import time
from collections.abc import Collection
from typing import Any

MOST_NAMES = 256
"""Names of one kind that are kept; a large suite has some tens."""

LONGEST_NAME = 256
"""Letters of a name."""

_LINE_PERIOD_S = 600.0
_logged_s: dict[str, float] = {}


def has_room(names: Collection[Any], name: Any, kind: str, most: int = MOST_NAMES) -> bool:
    """True if a name is kept already, or may be; if not, one line in ten minutes says so.

    Args:
        names: those that are kept.
        name: a text, or a tuple of texts.
        kind: of the names, for the line.
        most: names that are kept.
    """
    if name in names:
        return True
    length = len(name) if isinstance(name, str) else sum(map(len, name))
    if len(names) < most and length <= LONGEST_NAME:
        return True
    now_s = time.monotonic()
    if now_s - _logged_s.get(kind, -_LINE_PERIOD_S) >= _LINE_PERIOD_S:
        _logged_s[kind] = now_s
        why = f"{len(names)} are known, the most that are kept" if len(names) >= most else f"it has {length} letters"
        logging.getLogger(__name__).warning(f"{kind} {str(name)[:60]!r} and others are not shown: {why}")
    return False
