"""LAPACK as scipy wraps it, without the rest of scipy: ``lapack.dposv``.

``import scipy.linalg.lapack`` imports five hundred modules, which takes longer than all other imports of a node, and
``import scipy`` forty. The wrapped functions are in one library of scipy. They are the same objects as in
``scipy.linalg.lapack``.
"""

import sys
from types import ModuleType
from typing import Any

_LIBRARY = "scipy.linalg._flapack"
_FUNCTIONS = ("dgesdd", "dposv", "dpotrf", "dpotri")


def _wrapped_library() -> ModuleType:
    """Import the library under its own name, so that a later import of scipy finds it."""
    if _LIBRARY in sys.modules:
        return sys.modules[_LIBRARY]
    import importlib.util
    from importlib.machinery import PathFinder

    scipy = importlib.util.find_spec("scipy")
    folders = scipy.submodule_search_locations if scipy is not None else None
    spec = PathFinder.find_spec(_LIBRARY, [f"{folder}/linalg" for folder in folders or ()])
    if spec is None or spec.loader is None:
        from scipy.linalg import lapack  # another location in this version of scipy

        elsewhere: ModuleType = lapack
        return elsewhere
    library = sys.modules[_LIBRARY] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(library)
    return library


def __getattr__(name: str) -> Any:
    """Return a function of the library, which is imported on first use: a node without stars never needs it."""
    if name not in _FUNCTIONS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    library = _wrapped_library()
    globals().update({function: getattr(library, function) for function in _FUNCTIONS})
    return globals()[name]
