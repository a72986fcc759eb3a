"""Parameters of the deflection of the vertical: source, uncertainty and correlation length."""

import math
from dataclasses import dataclass

from ship_estimation.parameters.fields import arcsec, parameter
from ship_estimation.parameters.schema import ParameterError

NONE, UNKNOWN, CONSTANT, TABLE, TOPIC = "none", "unknown", "constant", "table", "topic"

_TABLE_COLUMNS = ("table_latitude_deg", "table_longitude_deg", "table_xi_arcsec", "table_eta_arcsec")


def _component_arcsec(doc: str) -> float:
    found: float = parameter(0.0, doc=doc, unit="arcsec", minimum=-300.0, maximum=300.0)
    return found


def _column(doc: str, unit: str, most: float) -> tuple[float, ...]:
    found: tuple[float, ...] = parameter((), doc=doc, unit=unit, minimum=-most, maximum=most)
    return found


@dataclass(frozen=True, kw_only=True)
class GravityConfig:
    """Parameters of the deflection of the vertical, which is part of the tilt of an INS levelled by gravity.

    The deflection is the direction of the astronomical zenith relative to the geodetic zenith, with the components xi
    northward and eta eastward.
    """

    deflection: str = parameter(
        NONE,
        doc="source of the deflection; unknown: estimated by the filter; none: part of the correlated INS error; with "
        "ins.model schuler, none is as unknown, but not published",
        choices=(NONE, UNKNOWN, CONSTANT, TABLE, TOPIC),
    )
    xi_arcsec: float = _component_arcsec("the constant deflection, northward")
    eta_arcsec: float = _component_arcsec("the constant deflection, eastward")
    table_latitude_deg: tuple[float, ...] = _column("latitudes of the table's rows, along the track", "deg", 90.0)
    table_longitude_deg: tuple[float, ...] = _column("longitudes of the table's rows", "deg", 360.0)
    table_xi_arcsec: tuple[float, ...] = _column("deflections of the table's rows, northward", "arcsec", 300.0)
    table_eta_arcsec: tuple[float, ...] = _column("deflections of the table's rows, eastward", "arcsec", 300.0)
    table_reach_m: float = parameter(
        10_000.0,
        doc="the table is used up to this distance from its track; rows further apart are not interpolated",
        unit="m",
        minimum=1.0,
        maximum=1e6,
    )
    sigma_arcsec: float = arcsec(2.0, doc="error of a known deflection (constant, table, topic), each component")
    unknown_sigma_arcsec: float = arcsec(
        20.0, doc="standard deviation of an unknown deflection in the sea area, each component (vertical.md); 0: none"
    )
    correlation_length_m: float = parameter(
        30_000.0,
        doc="correlation length over ground of sigma_arcsec and unknown_sigma_arcsec",
        unit="m",
        minimum=100.0,
        maximum=1e6,
    )
    max_age_s: float = parameter(
        600.0, doc="maximum age of a message on gravity/deflection", unit="s", minimum=1.0, maximum=1e6
    )

    @property
    def is_modelled(self) -> bool:
        """True if the deflection is a state separate from the INS error."""
        return self.deflection != NONE

    def __post_init__(self) -> None:
        """Check parameters that depend on each other.

        Raises:
            ParameterError: the columns of the table differ in length or contain a value that is not finite, a table has
                fewer than two rows, or unknown_sigma_arcsec is 0 although the deflection is a state.
        """
        rows = len(self.table_latitude_deg)
        for name in _TABLE_COLUMNS:
            column = getattr(self, name)
            if len(column) != rows:
                text = f"parameter 'gravity.{name}' has {len(column)} values, table_latitude_deg has {rows}"
                raise ParameterError(f"{text}: give one of each for every row", f"gravity.{name}")
            if not all(math.isfinite(value) for value in column):
                raise ParameterError(f"parameter 'gravity.{name}' has a value that is not finite", f"gravity.{name}")
        if self.deflection == TABLE and rows < 2:
            text = f"parameter 'gravity.table_latitude_deg' has {rows} rows, and gravity.deflection is 'table'"
            raise ParameterError(f"{text}: give two rows or more", "gravity.table_latitude_deg")
        if self.is_modelled and not self.unknown_sigma_arcsec > 0.0:
            name = "gravity.unknown_sigma_arcsec"
            raise ParameterError(f"parameter '{name}' must be more than 0 if the deflection is a state", name)
