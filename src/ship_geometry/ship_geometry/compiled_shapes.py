# cython: language_level=3
"""Whether arrays fit together, asked by compiled loops, which look at no bounds; compiled as they are."""

import cython

if not cython.compiled:
    raise ImportError(f"{__name__} is not compiled: run make setup, or colcon build")


def check(what: str, fits: bool) -> None:
    """Refuse arrays whose shapes do not fit together.

    Args:
        what: which arrays these are.
        fits: whether they do.

    Raises:
        ValueError: they do not.

    Example:
        >>> check("rates", (4, 3)[1] == 3)
    """
    if not fits:
        raise ValueError(f"{what}: the shapes of the arrays do not fit together")
