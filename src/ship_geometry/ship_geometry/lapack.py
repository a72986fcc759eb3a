"""LAPACK as scipy wraps it, without the rest of scipy: ``from ship_geometry.lapack import dposv``.

``import scipy.linalg.lapack`` reads five hundred modules, which take longer than all else that a node reads, and
``import scipy`` forty; the wrapped functions stand in one library beside them. They are the same objects that
``scipy.linalg.lapack`` gives.
"""

import importlib.util
import sys
from importlib.machinery import PathFinder
from types import ModuleType

_LIBRARY = "scipy.linalg._flapack"


def _wrapped() -> ModuleType:
    """The library under its own name, where scipy finds it when something else needs more of scipy."""
    if _LIBRARY in sys.modules:
        return sys.modules[_LIBRARY]
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


_library = _wrapped()
dgesdd, dposv, dpotrf, dpotri = _library.dgesdd, _library.dposv, _library.dpotrf, _library.dpotri
