"""The last ``ship/alignment`` of a run in units that people read."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_geometry.rotations import ARCSEC, wrap_pi


@dataclass(frozen=True)
class AlignmentValue:
    """One estimated quantity.

    Attributes:
        name: as in AlignmentState.
        value: in ``unit``, angles from -180 deg to 180 deg.
        sigma: its standard deviation, same unit.
        unit: ``arcsec`` for errors of the INS, ``deg`` for installation angles, ``s`` for time offsets.
    """

    name: str
    value: float
    sigma: float
    unit: str


def alignment_values(message: Any) -> list[AlignmentValue]:
    """The values of an AlignmentState message."""
    count = len(message.names)
    sigmas = np.sqrt(np.diagonal(np.asarray(message.covariance).reshape(count, count)))
    values = []
    for name, value, sigma, unit in zip(message.names, message.values, sigmas, message.units, strict=True):
        scale, shown_unit = 1.0, unit
        if unit == "rad":
            value = float(wrap_pi(value))
            scale, shown_unit = (ARCSEC, "arcsec") if name.startswith("ins.") else (np.pi / 180.0, "deg")
        values.append(AlignmentValue(name, float(value) / scale, float(sigma) / scale, shown_unit))
    return values
