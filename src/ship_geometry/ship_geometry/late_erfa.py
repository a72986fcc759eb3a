"""The functions of ERFA, imported on first use: ``from ship_geometry import late_erfa as erfa``.

Its import would take a tenth of the start of a node that needs neither stars nor positions.
"""

from typing import Any


def __getattr__(name: str) -> Any:
    import erfa

    value = globals()[name] = getattr(erfa, name)
    return value
