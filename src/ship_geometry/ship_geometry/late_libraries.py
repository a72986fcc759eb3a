"""Libraries whose import takes long, imported on first use: ERFA, and LAPACK without the rest of scipy.

A node that uses neither stars nor positions needs neither of them.

``import scipy.linalg.lapack`` imports five hundred modules, which takes longer than all other imports of a node;
``import scipy`` imports forty. All functions of ``scipy.linalg.lapack`` are in one library of scipy, and only this
library is imported here.

Example:
    >>> erfa.gd2gc(erfa.WGS84, 0.0, 0.0, 0.0)[0].item()
    6378137.0
"""

import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

_LAPACK = "scipy.linalg._flapack"


class _LateLibrary:
    """The functions and constants of a library that is imported when the first of them is used."""

    def __init__(self, load: Callable[[], ModuleType]) -> None:
        self._load = load

    def __getattr__(self, name: str) -> Any:
        # Called only for a name that is not yet an attribute.
        value = getattr(self._load(), name)
        setattr(self, name, value)
        return value


def _import_erfa() -> ModuleType:
    import erfa as library

    module: ModuleType = library
    return module


def _import_lapack() -> ModuleType:
    """Import the library under its name in scipy, so that a later import of scipy uses it."""
    if _LAPACK in sys.modules:
        return sys.modules[_LAPACK]
    import importlib.util
    from importlib.machinery import PathFinder

    scipy = importlib.util.find_spec("scipy")
    folders = scipy.submodule_search_locations if scipy is not None else None
    spec = PathFinder.find_spec(_LAPACK, [f"{folder}/linalg" for folder in folders or ()])
    if spec is None or spec.loader is None:
        from scipy.linalg import lapack as elsewhere  # another location in this version of scipy

        module: ModuleType = elsewhere
        return module
    library = sys.modules[_LAPACK] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(library)
    return library


erfa = _LateLibrary(_import_erfa)
lapack = _LateLibrary(_import_lapack)
