"""Parameters of the ``ship_attitude`` node, with unit, range and meaning; parameter names are dotted."""

from dataclasses import dataclass

from ship_attitude_star.ship_attitude.devices import BY_INPUT, ShipSensors
from ship_attitude_star.vertical.config import GravityConfig
from ship_estimation.innovations.gates import GateConfig
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_estimation.parameters.fields import autosave_period, parameter, section, sources_off, stamp_age
from ship_estimation.parameters.frame_names import FrameNames, publish_tf
from ship_estimation.parameters.ins_errors import SCHULER
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.recovery.config import RecoveryConfig
from ship_stars.sky.config import SkyConfig

GEODETIC, GRAVITY = "geodetic", "gravity"

_SOLVED_INPUTS = ("solution", "horizon_attitude")
"""Inputs that are attitudes relative to the horizon."""


@dataclass(frozen=True, kw_only=True)
class ShipIntegrityConfig(IntegrityConfig):
    """Parameters of protection levels and fault exclusion of a ship."""

    pairs: bool = parameter(
        False,
        doc="detect two faulty sources at a time: one subfilter more for each pair of sources, the INS included, if"
        " three other sources are in use",
    )


@dataclass(frozen=True, kw_only=True)
class ShipAttitudeConfig(ShipSensors):
    """All parameters of ``ship_attitude``."""

    gravity: GravityConfig = section(GravityConfig)
    horizon: str = parameter(
        GEODETIC,
        doc="horizon of the published attitude: that of the ellipsoid, or of gravity (needs gravity.deflection)",
        choices=(GEODETIC, GRAVITY),
    )
    gate: GateConfig = section(GateConfig)
    integrity: ShipIntegrityConfig = section(ShipIntegrityConfig)
    recovery: RecoveryConfig = section(RecoveryConfig)
    sky: SkyConfig = section(SkyConfig)
    lag_s: float = parameter(
        2.0, doc="measurements up to this lag are applied at their own stamp", unit="s", minimum=0.0, maximum=600.0
    )
    smoothing_lag_s: float = parameter(
        0.0,
        doc="ship/attitude_smoothed is published this long after the stamp of each attitude, smoothed with all"
        " measurements until then, not before lag_s and ins.max_gap_s; 0: not published",
        unit="s",
        minimum=0.0,
        maximum=600.0,
    )
    coasting_after_s: float = parameter(
        2.0, doc="without stars for this long the status is COASTING", unit="s", minimum=0.1, maximum=3600.0, live=True
    )
    frames: FrameNames = section(FrameNames)
    publish_tf: bool = publish_tf()
    sources_off: tuple[str, ...] = sources_off()
    max_age_s: float = stamp_age()
    slow_topics_period_s: float = parameter(
        1.0, doc="period of budget, alignment, error and health topics", unit="s", minimum=0.1, maximum=60.0
    )
    alignment_file: str = parameter("", doc="file of the saved alignment, read at the start if it exists")
    alignment_autosave_s: float = autosave_period()
    alignment_max_age_d: float = parameter(
        30.0,
        doc="age above which the configured uncertainty is added to a saved alignment",
        unit="d",
        minimum=0.0,
        maximum=36500.0,
    )

    @property
    def models_deflection(self) -> bool:
        """True if the deflection of the vertical is a state.

        This is due to gravity.deflection, or to ins.model schuler with gravity.unknown_sigma_arcsec above 0.
        """
        drives_ins = self.ins.model == SCHULER and self.gravity.unknown_sigma_arcsec > 0.0
        return self.gravity.is_modelled or drives_ins

    @property
    def needs_vertical(self) -> bool:
        """True if the INS error model depends on the ship's position."""
        return self.models_deflection or self.ins.model == SCHULER

    def __post_init__(self) -> None:
        """Check parameters that depend on each other.

        Raises:
            ParameterError: two parameters contradict each other.
        """
        super().__post_init__()
        if self.horizon == GRAVITY and not self.gravity.is_modelled:
            text = "parameter 'horizon' = gravity: set gravity.deflection, otherwise both horizons are the same"
            raise ParameterError(text, "horizon")
        for id_, star in self.star_sensors.items():
            if star.shared != BY_INPUT and star.input not in _SOLVED_INPUTS:
                name = f"star_sensors.{id_}.shared"
                text = f"'{star.shared}' needs input: solution or horizon_attitude; '{star.input}' shares sky errors"
                raise ParameterError(f"parameter '{name}': {text}", name)
