"""Gates: how improbable a residual may be before its measurement is refused."""

from functools import cache

from scipy.special import chdtri


@cache
def chi_square_gate(probability: float, degrees: int) -> float:
    """The chi² value that a consistent measurement of ``degrees`` components stays below with ``probability``."""
    return float(chdtri(degrees, 1.0 - probability))
