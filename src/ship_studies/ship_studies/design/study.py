"""Results of a design study, for its tables, figures and page.

Each sweep changes one quantity; the sweeps of focal length, pixel pitch and RTK noise also change errors in proportion.
A sweep gives the error for the given beacons. For some values each sweep except ``separation`` also gives the error for
beacons at the best positions within the limits of ``escort``.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AxisErrors, encoder_angles
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between
from ship_studies.design.config import DesignStudyConfig, with_image_sigma
from theodolite_calib.config import EscortConfig, OpticalAxisConfig
from theodolite_calib.escort.accuracy import BeaconAccuracy
from theodolite_calib.escort.advice import EscortAdvice, advise
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.samples.tracks import EncoderAt, ShipAt

SWEEP_COUNT = 25
"""Number of values of a sweep."""
BEST_STEP = 4
"""Step between values for which the best positions are computed; for every value the computation would be slow."""
_FACTORS = np.geomspace(0.2, 5.0, SWEEP_COUNT)
_SURVEY_M = np.geomspace(1e-3, 0.2, SWEEP_COUNT)

_UNKNOWN = np.full((3, 3), np.nan)


@dataclass(frozen=True)
class DesignSweep:
    """Error of the pointing as a function of one quantity of the design.

    Attributes:
        name: name of the quantity.
        label: label of the quantity in a figure.
        unit: unit of the values.
        values: values of the quantity, shape (n,).
        given: value of the quantity in the study.
        sigma_arcsec: error of the pointing on the sky with the given beacons, shape (n,); NaN if a beacon is behind the
            telescope.
        best_arcsec: error with the beacons at the best positions within the limits, shape (n,); NaN if not computed, or
            if no position is within the limits.
    """

    name: str
    label: str
    unit: str
    values: FloatArray
    given: float
    sigma_arcsec: FloatArray
    best_arcsec: FloatArray


@dataclass(frozen=True)
class SourceSigma:
    """Error of the pointing due to one source, arcsec: azimuth times cos E, elevation, on the sky, shape (3,)."""

    source: str
    given_arcsec: FloatArray
    advised_arcsec: FloatArray


@dataclass(frozen=True)
class DesignStudy:
    """Design and its results.

    Attributes:
        config: configuration of the study.
        given_n: positions of the given beacons, from the ship's antenna (N, U, E), m, shape (N, 3).
        given_arcsec: error with the given beacons in azimuth times cos E, in elevation and on the sky, shape (3,).
        unaided_arcsec: error on the sky from encoders and ship without beacons.
        advice: best positions within the limits, and the accuracy at these positions.
        advised_arcsec: error with the advised positions, as ``given_arcsec``; NaN if no position is within the limits.
        budget: errors with the given and with the advised beacons by source; their root sums of squares are
            ``given_arcsec`` and ``advised_arcsec``.
        sweeps: sweeps over the quantities of the design.
        places_deg: angles of the given and the advised beacons to the right of the axis and above it, shape (2, N, 2).
        distances_m: distances of these beacons from the theodolite, shape (2, N).
    """

    config: DesignStudyConfig
    given_n: FloatArray
    given_arcsec: FloatArray
    unaided_arcsec: float
    advice: EscortAdvice
    advised_arcsec: FloatArray
    budget: list[SourceSigma]
    sweeps: list[DesignSweep]
    places_deg: FloatArray
    distances_m: FloatArray

    @property
    def meets_requirement(self) -> bool:
        """True if the given beacons meet the requirement, or the study has no requirement."""
        required_arcsec = self.config.required_arcsec
        return required_arcsec == 0.0 or bool(self.given_arcsec[2] <= required_arcsec)


def compute_study(config: DesignStudyConfig) -> DesignStudy:
    """Return all results of a study."""
    design = _Design(config, config.optical_axis)
    given_n = design.beacon_positions_n(config.direction_tangents(), config.distances_m())
    advice = design.advice()
    has_positions = np.isfinite(advice.sigma_advised)
    given = design.accuracy.budget(config.names, given_n)
    advised = design.accuracy.budget(config.names, advice.places_n) if has_positions else dict.fromkeys(given, _UNKNOWN)
    budget = [
        SourceSigma(source, design.sigmas_arcsec(given[source]), design.sigmas_arcsec(advised[source]))
        for source in given
        if np.any(given[source]) or np.any(advised[source])
    ]
    places = [design.angles_and_distances(places_n) for places_n in (given_n, advice.places_n)]
    return DesignStudy(
        config=config,
        given_n=given_n,
        given_arcsec=_total(source.given_arcsec for source in budget),
        unaided_arcsec=design.accuracy.sigma((), np.empty((0, 3))) / ARCSEC,
        advice=advice,
        advised_arcsec=_total(source.advised_arcsec for source in budget),
        budget=budget,
        sweeps=list(_sweeps(config)),
        places_deg=np.array([angles_deg for angles_deg, _ in places]),
        distances_m=np.array([distances_m for _, distances_m in places]),
    )


def _total(columns: Iterable[FloatArray]) -> FloatArray:
    total: FloatArray = np.sqrt(np.sum(np.square(list(columns)), axis=0))
    return total


class _Design:
    """Theodolite of a study with the study's pointing, on a level ship that heads North.

    Args:
        config: configuration of the study.
        node: configuration of the node ``optical_axis``, possibly changed by a sweep.
    """

    def __init__(self, config: DesignStudyConfig, node: OpticalAxisConfig) -> None:
        self._config, self._node = config, node
        axis_n = rotation_from_angles(*np.deg2rad([config.azimuth_deg, config.elevation_deg, 0.0]).tolist())[:, 0]
        azimuth, elevation = encoder_angles(AxisErrors.from_vector(node.axes.values), axis_n)
        tilt, heading = config.ship_tilt_sigma_arcsec * ARCSEC, config.ship_heading_sigma_arcsec * ARCSEC
        stated_n = np.diag([tilt, heading, tilt]) ** 2
        by_ins = node.ship.source == "ins/imu"
        white = node.ins.white_sigma_arcsec if by_ins else node.ship.white_sigma_arcsec
        ship = ShipAt(np.eye(3), np.zeros(3), None if by_ins else stated_n, (white * ARCSEC) ** 2)
        encoder = EncoderAt(float(azimuth), float(elevation), (node.encoder.sigma_arcsec * ARCSEC) ** 2)
        self.accuracy = BeaconAccuracy(node, CalibrationFilter(node), ship, encoder)

    def beacon_positions_n(self, tangents: FloatArray, distances_m: FloatArray) -> FloatArray:
        """Return beacon positions (N, U, E), m, (N, 3), from distances and the tangents of angles from the axis."""
        path_t = np.column_stack([np.ones(len(tangents)), tangents[:, 1], tangents[:, 0]])
        path_t *= (distances_m / np.linalg.norm(path_t, axis=1))[:, None]
        places_n: FloatArray = self.accuracy.centre_n + path_t @ self.accuracy.rotation_nt.T
        return places_n

    def angles_and_distances(self, places_n: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return angles of positions to the right of and above the axis, deg, (N, 2), and their distances, m, (N,)."""
        path_t = (places_n - self.accuracy.centre_n) @ self.accuracy.rotation_nt
        angles_deg: FloatArray = np.rad2deg(np.arctan2(path_t[:, [2, 1]], path_t[:, :1]))
        return angles_deg, np.linalg.norm(path_t, axis=1)

    def advice(self) -> EscortAdvice:
        return advise(self._node.escort, self.accuracy, self._config.names, {})

    def sigmas_arcsec(self, covariance_n: FloatArray) -> FloatArray:
        """Return the error of the pointing in azimuth times cos E, in elevation, and on the sky, shape (3,)."""
        rotation_nm = self.accuracy.rotation_nm
        variances = np.diagonal(rotation_nm.T @ covariance_n @ rotation_nm)[1:]
        # Rounding may leave a negative variance for a source without effect.
        variances = np.maximum(variances, 0.0)
        sigmas: FloatArray = np.sqrt(np.append(variances, variances.sum())) / ARCSEC
        return sigmas


def _sweeps(config: DesignStudyConfig) -> Iterator[DesignSweep]:
    node, names = config.optical_axis, config.names
    tangents, distances_m = config.direction_tangents(), config.distances_m()
    escort, telescope = node.escort, node.telescope

    def sweep(
        name: str,
        label: str,
        unit: str,
        given: float,
        values: FloatArray,
        node_of: Callable[[float], OpticalAxisConfig] = lambda value: node,
        lights_of: Callable[[float], tuple[FloatArray, FloatArray]] = lambda value: (tangents, distances_m),
        best: bool = True,
    ) -> DesignSweep:
        sigma, best_sigma = np.full(len(values), np.nan), np.full(len(values), np.nan)
        for number, value in enumerate(values.tolist()):
            design = _Design(config, node_of(value))
            sigma[number] = design.accuracy.sigma(names, design.beacon_positions_n(*lights_of(value)))
            if best and number % BEST_STEP == 0:
                best_sigma[number] = design.advice().sigma_advised
        return DesignSweep(name, label, unit, values, given, sigma / ARCSEC, best_sigma / ARCSEC)

    distance_m = float(np.mean(distances_m))
    yield sweep(
        "distance",
        "distance of the lights",
        "m",
        distance_m,
        distance_m * _FACTORS,
        node_of=lambda value: replace(node, escort=_at_range(escort, value)),
        lights_of=lambda value: (tangents, distances_m * (value / distance_m)),
    )
    if len(names) > 1:
        middle, separation_deg = tangents.mean(axis=0), _separation_deg(tangents)
        widest = _factor_in_field(tangents, middle, float(np.tan(np.deg2rad(escort.field_deg))))
        yield sweep(
            "separation",
            "widest angle between the lights",
            "deg",
            separation_deg,
            separation_deg * widest * np.geomspace(0.05, 1.0, SWEEP_COUNT),
            lights_of=lambda value: (middle + (tangents - middle) * (value / separation_deg), distances_m),
            best=False,
        )
    yield sweep(
        "focal_length",
        "focal length, its error in proportion",
        "m",
        telescope.focal_length_m,
        telescope.focal_length_m * _FACTORS,
        node_of=lambda value: replace(
            node,
            telescope=replace(
                telescope,
                focal_length_m=value,
                focal_length_sigma_m=telescope.focal_length_sigma_m * value / telescope.focal_length_m,
            ),
        ),
    )
    yield sweep(
        "pixel",
        "pixel pitch, the centroid's error in proportion",
        "m",
        config.pixel_pitch_m,
        config.pixel_pitch_m * _FACTORS,
        node_of=lambda value: with_image_sigma(node, value * config.centroid_sigma_px),
    )
    yield sweep(
        "lever",
        "error of the theodolite's lever, each axis",
        "m",
        node.lever.sigma_m,
        _SURVEY_M,
        node_of=lambda value: replace(node, lever=replace(node.lever, sigma_m=value)),
    )
    rtk_m = next(iter(node.beacons.values())).rtk.sigma_m
    yield sweep(
        "rtk",
        f"noise of RTK at {names[0]}, all its errors in proportion",
        "m",
        rtk_m,
        rtk_m * _FACTORS,
        node_of=lambda value: _with_rtk(node, value / rtk_m),
    )
    yield sweep(
        "principal_point",
        "error of N′, each axis",
        "m",
        telescope.lens.sigma_m,
        _SURVEY_M,
        node_of=lambda value: replace(node, telescope=replace(telescope, lens=replace(telescope.lens, sigma_m=value))),
    )


def _at_range(escort: EscortConfig, range_m: float) -> EscortConfig:
    """Return limits that allow only one range; a minimum separation too large for this range is reduced."""
    widest_m = 2.0 * range_m * float(np.sin(np.deg2rad(escort.field_deg)))
    separation_m = min(escort.separation_min_m, 0.999 * widest_m)
    return replace(escort, range_min_m=range_m, range_max_m=range_m, separation_min_m=separation_m)


def _with_rtk(node: OpticalAxisConfig, factor: float) -> OpticalAxisConfig:
    """Return the configuration with all RTK errors multiplied by a factor."""
    beacons = {
        name: replace(
            beacon,
            rtk=replace(beacon.rtk, sigma_m=factor * beacon.rtk.sigma_m, bias_sigma_m=factor * beacon.rtk.bias_sigma_m),
        )
        for name, beacon in node.beacons.items()
    }
    antenna = replace(node.ship_antenna, sigma_m=factor * node.ship_antenna.sigma_m)
    return replace(node, beacons=beacons, ship_antenna=antenna)


def _separation_deg(tangents: FloatArray) -> float:
    """Return the widest angle between any two beacons, from the tangents of their angles from the axis."""
    path_t = np.column_stack([np.ones(len(tangents)), tangents[:, 1], tangents[:, 0]])
    return float(np.rad2deg(np.max(angle_between(path_t[:, None], path_t))))


def _factor_in_field(tangents: FloatArray, middle: FloatArray, field: float) -> float:
    """Return the factor on all offsets from ``middle`` at which the first beacon leaves the field, at most 1000.

    Args:
        tangents: tangents of the beacons' angles from the axis, shape (N, 2), within the field.
        middle: mean of the tangents, shape (2,).
        field: tangent of the radius of the field.
    """
    away = tangents - middle
    squared, across = np.sum(away**2, axis=1), away @ middle
    # The factor k is the greater root of |middle + k away| = field. A beacon at the middle never leaves the field.
    moving = squared > 0.0
    squared, across = squared[moving], across[moving]
    roots = (np.sqrt(across**2 + squared * (field**2 - middle @ middle)) - across) / squared
    return float(np.min(roots, initial=1e3))
