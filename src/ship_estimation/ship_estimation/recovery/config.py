"""The parameters of recovery."""

from dataclasses import dataclass

from ship_estimation.parameter_fields import parameter


@dataclass(frozen=True, kw_only=True)
class RecoveryConfig:
    """When a second estimator starts beside the first one, and when it replaces it."""

    after_s: float = parameter(
        5.0,
        doc="a second estimator starts where the status has been worse than the inputs allow, or a source excluded, "
        "for so long",
        unit="s",
        minimum=1.0,
        maximum=1e6,
    )
    confirm_s: float = parameter(
        60.0,
        doc="the second estimator is adopted where it has been VALID, with all sources, for so long",
        unit="s",
        minimum=10.0,
        maximum=1e6,
    )
