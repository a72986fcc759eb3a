"""All numbers of a layout study in one place: tables, figures and page only show them."""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.layout.azimuths import AzimuthScan, recommended, scan
from ship_attitude_star.layout.config import LEAST_ELEVATION_DEG, LayoutStudyConfig
from ship_attitude_star.layout.joint_error import ErrorMap, Layout, SourceError, error_map
from ship_attitude_star.layout.sweeps import Curve, all_curves
from ship_estimation.parameters import ParameterError
from ship_geometry.rotations import FloatArray


@dataclass(frozen=True)
class LayoutStudy:
    """A layout and everything said about it.

    Attributes:
        config: what was asked.
        layout: as given.
        alone_arcsec: sigma of heading, pitch, roll of each sensor alone, shape (N, 3).
        joint_arcsec: of all together, shape (3,).
        best: the layout at the recommended azimuths.
        best_arcsec: its sigmas, shape (3,).
        scans: the error while each sensor of ``best`` but the first, or the only one, is turned in azimuth.
        maps: the error of ``layout`` while each sensor is bolted anywhere.
        budget: the joint error of ``layout`` by source.
        curves: of the six figures of [Z14].
    """

    config: LayoutStudyConfig
    layout: Layout
    alone_arcsec: FloatArray
    joint_arcsec: FloatArray
    best: Layout
    best_arcsec: FloatArray
    scans: list[AzimuthScan]
    maps: list[ErrorMap]
    budget: list[SourceError]
    curves: list[Curve]


def study(config: LayoutStudyConfig) -> LayoutStudy:
    """All numbers of a study.

    Raises:
        ParameterError: with the ship's pitch and roll a sensor looks too low.
    """
    layout = Layout.from_config(config)
    for name, elevation_deg in zip(layout.names, layout.horizon_elevations_deg(), strict=True):
        if elevation_deg < LEAST_ELEVATION_DEG - 1e-9:
            raise ParameterError(
                f"parameter 'sensors.{name}.elevation_deg': with the ship's pitch and roll the boresight is at "
                f"{elevation_deg:.1f} deg over the horizon, expected at least {LEAST_ELEVATION_DEG:g} deg",
                f"sensors.{name}.elevation_deg",
            )
    best = recommended(layout)
    count = len(layout.names)
    return LayoutStudy(
        config=config,
        layout=layout,
        alone_arcsec=np.array([layout.of_sensor(number).sigmas_arcsec() for number in range(count)]),
        joint_arcsec=layout.sigmas_arcsec(),
        best=best,
        best_arcsec=best.sigmas_arcsec(),
        scans=[scan(best, number) for number in range(min(1, count - 1), count)],
        maps=[error_map(layout, number) for number in range(count)],
        budget=layout.budget(),
        curves=all_curves(config.figures),
    )
