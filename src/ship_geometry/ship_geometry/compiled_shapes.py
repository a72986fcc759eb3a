# cython: language_level=3
"""Check of array shapes for the compiled modules, whose loops do not check bounds."""

import cython

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")


def check(what: str, fits: bool) -> None:
    """Raise an error if the shapes of arrays do not match.

    Args:
        what: name of the arrays, for the error text.
        fits: True if the shapes match.

    Raises:
        ValueError: the shapes do not match.

    Example:
        >>> check("rates", (4, 3)[1] == 3)
    """
    if not fits:
        raise ValueError(f"{what}: the shapes of the arrays do not fit together")
