"""The functions of ERFA, read when the first one is asked for: ``from ship_geometry import late_erfa as erfa``.

Reading it takes a tenth of the start of a node that looks at no star and knows no place.
"""

from typing import Any


def __getattr__(name: str) -> Any:
    import erfa

    value = globals()[name] = getattr(erfa, name)
    return value
