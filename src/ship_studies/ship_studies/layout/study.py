"""Computation of all numbers of a layout study, recommended azimuths included, for tables, figures and page.

The recommended azimuths have the least total error, within 2 %. The first sensor keeps its azimuth and the other
sensors are rotated: on a level ship only differences in azimuth matter.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_estimation.parameters.schema import ParameterError
from ship_geometry.rotations import FloatArray, wrap_pi
from ship_studies.layout.config import MIN_ELEVATION_DEG, LayoutStudyConfig
from ship_studies.layout.error_budget import ErrorMap, Layout, SourceError, error_map, total_arcsec
from ship_studies.layout.field_of_view import MIN_STARS, Obstructions, SkyStatistics, sky_statistics
from ship_studies.layout.installation_model import Curve, all_curves
from ship_studies.layout.requirement import RequirementResult, evaluate_layouts

_STEP_DEG = 1.0
_EQUAL_RATIO = 1e-9
"""Relative difference below which total errors are equal; then the azimuth nearest to the present azimuth is taken."""
_MIN_GAIN_RATIO = 0.02
"""Minimum relative gain of another arrangement over the arrangement near the given azimuths."""
_ALLOWED_LOSS_RATIO = 0.1
"""Maximum relative increase of the total error above its minimum for an azimuth to count as good."""
_MAX_ROUNDS = 20


@dataclass(frozen=True)
class AzimuthScan:
    """The joint error over the azimuth of one sensor, with the other sensors fixed.

    Attributes:
        sensor: sensor that is rotated.
        azimuths_deg: azimuths in [0, 360), shape (n,).
        sigmas_arcsec: sigmas of heading, pitch, roll, shape (n, 3); NaN at azimuths with a mask in the sensor's field.
        good_deg: range of good azimuths (from, to), clockwise, around the sensor's own azimuth: the total error is at
            most a tenth above its minimum. None if the own azimuth is not good.
    """

    sensor: str
    azimuths_deg: FloatArray
    sigmas_arcsec: FloatArray
    good_deg: tuple[float, float] | None


@dataclass(frozen=True)
class LayoutStudy:
    """A layout and all results of its study.

    Attributes:
        config: parameters of the study.
        layout: layout as given.
        alone_arcsec: sigma of heading, pitch, roll of each sensor of ``layout`` alone, shape (N, 3).
        joint_arcsec: sigma of heading, pitch, roll of all sensors of ``layout`` together, shape (3,).
        best: layout at the recommended azimuths.
        best_arcsec: sigma of heading, pitch, roll of all sensors of ``best``, shape (3,).
        scans: error over the azimuth of each sensor of ``best`` except the first, or of the only sensor.
        maps: error of ``layout`` over the mounting direction of each sensor.
        budget: joint error of ``layout`` by source.
        curves: curves of the six figures of [Z14].
        optics: results of the sensors' optics over the sky, by sensor name.
        obstructions: masks and horizon.
        requirement_result: results of the requirement; None without a requirement.
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
    optics: dict[str, SkyStatistics]
    obstructions: Obstructions
    requirement_result: RequirementResult | None


def compute_study(config: LayoutStudyConfig) -> LayoutStudy:
    """Compute all numbers of a study.

    Raises:
        ParameterError: a boresight is too low with the ship's pitch and roll, a mask is invalid or in a field of view,
            or a field has too few stars in much of the sky.
    """
    optics = {name: sky_statistics(of_sensor) for name, of_sensor in config.optics.items()}
    config = _with_optics_noise(config, optics)
    layout = Layout.from_config(config)
    for name, elevation_deg in zip(layout.names, layout.horizon_elevations_deg(), strict=True):
        if elevation_deg < MIN_ELEVATION_DEG - 1e-9:
            raise ParameterError(
                f"parameter 'sensors.{name}.elevation_deg': with the ship's pitch and roll the boresight is "
                f"{elevation_deg:.1f} deg above the horizon, expected at least {MIN_ELEVATION_DEG:g} deg",
                f"sensors.{name}.elevation_deg",
            )
    obstructions = _check_fields_of_view(config, layout)
    best = recommend_azimuths(layout, obstructions)
    maps = [error_map(layout, number) for number in range(len(layout.names))]
    count = len(layout.names)
    return LayoutStudy(
        config=config,
        layout=layout,
        alone_arcsec=np.array([layout.single_sensor(number).sigmas_arcsec() for number in range(count)]),
        joint_arcsec=layout.sigmas_arcsec(),
        best=best,
        best_arcsec=best.sigmas_arcsec(),
        scans=[scan_azimuth(best, number, obstructions) for number in range(min(1, count - 1), count)],
        maps=maps,
        budget=layout.budget(),
        curves=all_curves(config.figures),
        optics=optics,
        obstructions=obstructions,
        requirement_result=evaluate_layouts(config, layout, best, maps, obstructions)
        if config.requirement.is_given
        else None,
    )


def _with_optics_noise(config: LayoutStudyConfig, optics: dict[str, SkyStatistics]) -> LayoutStudyConfig:
    """Return the study in which the noise of each sensor with optics is computed from these optics.

    Raises:
        ParameterError: too large a share of the sky has too few stars.
    """
    sensors = dict(config.sensors)
    for name, found in optics.items():
        if not np.isfinite(found.quantile_arcsec).all():
            raise ParameterError(
                f"parameter 'optics.{name}.magnitude_limit': "
                f"in {100.0 * found.share_without_attitude():.0f} % of the sky the "
                f"field of {found.field_deg[0]:.1f} x {found.field_deg[1]:.1f} deg contains fewer than {MIN_STARS} "
                f"stars, more than sky_share = {config.optics[name].sky_share:g} allows: expected fainter stars or a "
                "wider field",
                f"optics.{name}.magnitude_limit",
            )
        forward, up, right = (float(sigma) for sigma in found.quantile_arcsec)
        sensors[name] = replace(
            sensors[name], sigma_forward_arcsec=forward, sigma_up_arcsec=up, sigma_right_arcsec=right
        )
    return replace(config, sensors=sensors)


def _check_fields_of_view(config: LayoutStudyConfig, layout: Layout) -> Obstructions:
    """Return the obstructions, after a check that no mask is in the field of a sensor as given.

    Raises:
        ParameterError: a mask is invalid, or is in a field; the text then gives the nearest clear azimuth, if any.
    """
    obstructions = Obstructions.from_config(config)
    for number, name in enumerate(layout.names):
        reaching = obstructions.masks_in_view(number, layout.angles[number])
        if not reaching:
            continue
        turned = np.tile(layout.angles[number], (72, 1))
        turned[:, 0] = np.deg2rad(np.arange(0.0, 360.0, 5.0))
        clear_deg = np.rad2deg(turned[obstructions.is_clear(number, turned), 0])
        away = np.abs(wrap_pi(np.deg2rad(clear_deg) - layout.angles[number, 0]))
        instead = (
            f"the nearest clear azimuth at this elevation is {clear_deg[int(np.argmin(away))]:.0f} deg"
            if clear_deg.size
            else f"the masks {', '.join(config.masks)} leave no clear azimuth at this elevation"
        )
        raise ParameterError(
            f"parameter 'sensors.{name}.azimuth_deg': {', '.join(reaching)} is in the field of view: {instead}",
            f"sensors.{name}.azimuth_deg",
        )
    return obstructions


def recommend_azimuths(layout: Layout, obstructions: Obstructions | None = None) -> Layout:
    """Return the layout with the clear azimuths of least total error, within 2 %; the first sensor keeps its azimuth.

    The search starts from the given azimuths, and from azimuths spaced evenly over half a circle and the whole circle.
    """
    count = len(layout.names)
    first = layout.angles[0, 0]
    starts = [layout.angles[:, 0]]
    starts += [first + np.arange(count) * circle / count for circle in (np.pi, 2.0 * np.pi)]
    layouts = [_with_azimuths(layout, azimuths) for azimuths in starts]
    # On a heeled ship a sensor of the other two starts may point below the horizon, where no error is finite.
    candidates = [_descend(start, obstructions) for start in layouts if np.isfinite(start.sigmas_arcsec()).all()]
    # Of nearly equal layouts the first layout is taken, which results from the given azimuths and changes least.
    totals = np.array([total_arcsec(candidate.sigmas_arcsec()) for candidate in candidates])
    return candidates[int(np.argmax(totals <= totals.min() * (1.0 + _MIN_GAIN_RATIO)))]


def scan_azimuth(layout: Layout, number: int, obstructions: Obstructions | None = None) -> AzimuthScan:
    """Return the error over all azimuths of the sensor with index ``number``; NaN where a mask is in its field."""
    azimuths_deg = np.arange(0.0, 360.0, _STEP_DEG)
    angles = np.tile(layout.angles, (azimuths_deg.size, 1, 1))
    angles[:, number, 0] = np.deg2rad(azimuths_deg)
    sigmas = layout.sigmas_arcsec(angles)
    if obstructions is not None:
        clear = obstructions.is_clear(number, angles[:, number])
        # If a gap between masks is narrower than the steps, no azimuth is clear, and no error is set to NaN.
        sigmas[~clear & clear.any()] = np.nan
    good = total_arcsec(sigmas) <= np.nanmin(total_arcsec(sigmas)) * (1.0 + _ALLOWED_LOSS_RATIO)
    own = round(np.rad2deg(layout.angles[number, 0]) / _STEP_DEG) % azimuths_deg.size
    return AzimuthScan(layout.names[number], azimuths_deg, sigmas, _good_range(good, own, azimuths_deg))


def _descend(layout: Layout, obstructions: Obstructions | None) -> Layout:
    """Rotate each sensor except the first to its best azimuth in turn, until no sensor moves."""
    for _ in range(_MAX_ROUNDS):
        before = layout.angles[:, 0].copy()
        for number in range(1, len(layout.names)):
            scanned = scan_azimuth(layout, number, obstructions)
            totals = total_arcsec(scanned.sigmas_arcsec)
            best = scanned.azimuths_deg[totals <= np.nanmin(totals) * (1.0 + _EQUAL_RATIO)]
            away = np.abs(wrap_pi(np.deg2rad(best) - layout.angles[number, 0]))
            azimuths = layout.angles[:, 0].copy()
            azimuths[number] = np.deg2rad(best[int(np.argmin(away))])
            layout = _with_azimuths(layout, azimuths)
        if np.array_equal(before, layout.angles[:, 0]):
            break
    return layout


def _with_azimuths(layout: Layout, azimuths: FloatArray) -> Layout:
    angles = layout.angles.copy()
    angles[:, 0] = azimuths
    return replace(layout, angles=angles)


def _good_range(good: NDArray[np.bool_], own: int, azimuths_deg: FloatArray) -> tuple[float, float] | None:
    """Return first and last azimuth of the unbroken range of good azimuths around index ``own``, also across 0°."""
    if not good[own]:
        return None
    if good.all():
        return 0.0, 360.0
    size = good.size
    backward = next(step for step in range(1, size) if not good[(own - step) % size])
    forward = next(step for step in range(1, size) if not good[(own + step) % size])
    return float(azimuths_deg[(own - backward + 1) % size]), float(azimuths_deg[(own + forward - 1) % size])
