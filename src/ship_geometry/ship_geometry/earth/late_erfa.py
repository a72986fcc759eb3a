"""The functions of ERFA, imported on first use: ``from ship_geometry.earth import late_erfa as erfa``.

Nodes that use neither stars nor positions do not need ERFA, whose import would be a tenth of their start time.
"""

from typing import Any


def __getattr__(name: str) -> Any:
    import erfa

    value = globals()[name] = getattr(erfa, name)
    return value
