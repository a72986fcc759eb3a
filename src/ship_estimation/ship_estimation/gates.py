"""Gates: how improbable a residual may be before its measurement is refused."""

from dataclasses import dataclass
from functools import cache

from scipy.special import chdtri

from ship_estimation.parameters import parameter


@dataclass(frozen=True, kw_only=True)
class GateConfig:
    """When a measurement is too improbable to use, and what a run of such means."""

    probability: float = parameter(
        0.9999, doc="a consistent measurement passes with this probability", minimum=0.5, maximum=0.999999999, live=True
    )
    conflict_after: int = parameter(
        10, doc="refusals in a row of one source that are reported as a conflict", minimum=1, live=True
    )
    reopen_after: int = parameter(
        0, doc="refusals in a row that inflate the covariance to let the source back in; 0 never", minimum=0, live=True
    )
    reopen_factor: float = parameter(
        100.0, doc="factor on the covariance when a gate is re-opened", minimum=1.0, maximum=1e9, live=True
    )


@cache
def chi_square_gate(probability: float, degrees: int) -> float:
    """The chi² value that a consistent measurement of ``degrees`` components stays below with ``probability``."""
    return float(chdtri(degrees, 1.0 - probability))
