"""Parameters of the recovery."""

from dataclasses import dataclass

from ship_estimation.parameters.fields import parameter


@dataclass(frozen=True, kw_only=True)
class RecoveryConfig:
    """Parameters of the start and the adoption of a second estimator."""

    after_s: float = parameter(
        5.0,
        doc="time with a status worse than the inputs allow, or with an excluded source, after which a second "
        "estimator starts",
        unit="s",
        minimum=1.0,
        maximum=1e6,
    )
    confirm_s: float = parameter(
        60.0,
        doc="time for which the second estimator must be VALID with all sources before it is adopted",
        unit="s",
        minimum=10.0,
        maximum=1e6,
    )
