"""Some functions of ``scipy.linalg.lapack``, such as ``dposv``, imported without the rest of scipy.

``import scipy.linalg.lapack`` imports five hundred modules, which takes longer than all other imports of a node;
``import scipy`` imports forty. All functions of ``scipy.linalg.lapack`` are in one library of scipy, and only this
library is imported here.
"""

import sys
from types import ModuleType
from typing import Any

_LIBRARY = "scipy.linalg._flapack"
_FUNCTIONS = ("dgesdd", "dposv", "dpotrf", "dpotri")


def _wrapped_library() -> ModuleType:
    """Import the library under its name in scipy, so that a later import of scipy uses it."""
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
    """Return a function of the library; the library is imported on first use, and not by a node without stars."""
    if name not in _FUNCTIONS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    library = _wrapped_library()
    globals().update({function: getattr(library, function) for function in _FUNCTIONS})
    return globals()[name]
