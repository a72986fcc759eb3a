"""Whether arrays fit together, asked before compiled loops that look at no bounds."""


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
