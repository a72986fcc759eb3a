"""LAPACK as scipy wraps it, without the rest of scipy: ``lapack.dposv``.

``import scipy.linalg.lapack`` reads five hundred modules, which take longer than all else that a node reads, and
``import scipy`` forty; the wrapped functions stand in one library beside them. They are the same objects that
``scipy.linalg.lapack`` gives.
"""

import sys
from types import ModuleType
from typing import Any

_LIBRARY = "scipy.linalg._flapack"
_FUNCTIONS = ("dgesdd", "dposv", "dpotrf", "dpotri")


def _wrapped() -> ModuleType:
    """The library under its own name, where scipy finds it when something else needs more of scipy."""
    if _LIBRARY in sys.modules:
        return sys.modules[_LIBRARY]
    import importlib.util
    from importlib.machinery import PathFinder

    scipy = importlib.util.find_spec("scipy")
    folders = scipy.submodule_search_locations if scipy is not None else None
    spec = PathFinder.find_spec(_LIBRARY, [f"{folder}/linalg" for folder in folders or ()])
    if spec is None or spec.loader is None:
        from scipy.linalg import lapack  # a scipy that keeps it elsewhere

        elsewhere: ModuleType = lapack
        return elsewhere
    library = sys.modules[_LIBRARY] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(library)
    return library


def __getattr__(name: str) -> Any:
    """A function of the library, which is read when the first one is asked for: a node without stars never asks."""
    if name not in _FUNCTIONS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    library = _wrapped()
    globals().update({function: getattr(library, function) for function in _FUNCTIONS})
    return globals()[name]
