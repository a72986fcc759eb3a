"""The last ``ship/alignment`` or ``theodolite/calibration`` of a run in units that people read."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_geometry.rotations import ARCSEC, wrap_pi

_INSTALLED = "star.", "reference."
"""How names of installation angles begin."""


@dataclass(frozen=True)
class AlignmentValue:
    """One estimated quantity.

    Attributes:
        name: as in the message.
        value: in ``unit``, angles from -180 deg to 180 deg.
        sigma: its standard deviation, same unit.
        unit: ``arcsec`` for errors of the INS and of axes, ``deg`` for installation angles, ``s`` for time offsets, or
            ``m``.
    """

    name: str
    value: float
    sigma: float
    unit: str


def alignment_values(message: Any) -> list[AlignmentValue]:
    """The values of an AlignmentState or a TheodoliteCalibration."""
    count = len(message.names)
    sigmas = np.sqrt(np.diagonal(np.asarray(message.covariance).reshape(count, count)))
    values = []
    for name, value, sigma, unit in zip(message.names, message.values, sigmas, message.units, strict=True):
        scale, shown_unit = 1.0, unit
        if unit == "rad":
            value = float(wrap_pi(value))
            installed = name.startswith(_INSTALLED)
            scale, shown_unit = (np.pi / 180.0, "deg") if installed else (ARCSEC, "arcsec")
        values.append(AlignmentValue(name, float(value) / scale, float(sigma) / scale, shown_unit))
    return values
