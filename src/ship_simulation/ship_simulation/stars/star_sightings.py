"""Star sensors that observe the true sky: single stars, or attitudes against the ICRS, with their errors.

A sensor of single stars gives centroids with identities. The other sensors solve for their attitude, as most star
trackers do.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_geometry.earth.star_directions import StarPositions, fixed_stars
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_simulation.random_draws import Draws, arrival_times, centroids, is_outside, random_stream
from ship_simulation.scenario.scenario import Scenario, StarImaging
from ship_simulation.ship.attitude_device import DeviceExposures, StarSensorMotion
from ship_simulation.stars.sky import TrueSky, julian_year, position_of_date
from ship_simulation.stars.true_camera import DetectorErrors, draw_optics, stars_in_field, swap_identities
from ship_stars.camera.camera import equivalent_sigma
from ship_stars.sky.catalogue import UNKNOWN

MAGNITUDE_SIGMA = 0.2
"""Standard deviation of measured magnitudes."""

# Error that the estimator assumes for a star position that is not from its catalogue (``star_messages``).
_GIVEN_DIRECTION_SIGMA = 0.05 * ARCSEC


@dataclass(frozen=True)
class ReportedStars:
    """Stars as a sensor reports them, one entry per star.

    The fields have the names of an estimator's exposure, which is not imported here; a test compares the two.

    Attributes:
        hip: reported HIP number, shape (k,); 0 if the sensor identifies stars by their directions, or not at all.
        directions_s: unit vectors from the centroids, in the sensor frame (forward, up, right), shape (k, 3).
        sigma: error of a direction, rad per axis across it, shape (k,).
        positions: positions of the reported stars, J2000.0 for HIP numbers, of date for directions; NaN if the sensor
            reports no identity.
        position_sigma: error of ``positions``, rad per axis, shape (k,).
        magnitude: measured magnitudes, shape (k,).
    """

    hip: NDArray[np.int64]
    directions_s: FloatArray
    sigma: FloatArray
    positions: StarPositions
    position_sigma: FloatArray
    magnitude: FloatArray

    def __len__(self) -> int:
        return len(self.hip)

    def __getitem__(self, rows: Any) -> "ReportedStars":
        """Return some of the stars."""
        return ReportedStars(*(getattr(self, field)[rows] for field in vars(self)))


@dataclass(frozen=True)
class StarSightings:
    """The exposures of a sensor that gives single stars; the stars of all exposures are concatenated.

    Attributes:
        time_ns: middle of each exposure, stamp of the sensor, increasing, shape (n,).
        log_time_ns: arrival times, in any order, shape (n,).
        first: the stars of exposure i are those from first[i] up to first[i + 1], shape (n + 1,).
        pixel: centroids (u, v), shape (k, 2).
        sigma_px: error of u and of v that the sensor states.
        stars: the reported stars.
    """

    time_ns: NDArray[np.int64]
    log_time_ns: NDArray[np.int64]
    first: NDArray[np.int64]
    pixel: FloatArray
    sigma_px: float
    stars: ReportedStars

    def rows(self, index: int) -> slice:
        """Return the slice of an exposure's stars."""
        return slice(int(self.first[index]), int(self.first[index + 1]))


@dataclass(frozen=True)
class SightingsTruth:
    """True attitudes of the sensor, and true identities of the stars of :class:`StarSightings`, in the same order.

    Attributes:
        rotation_nv: horizon from sensor at each exposure, shape (n, 3, 3).
        hip: true HIP number, shape (k,); 0 for a false spot.
        direction_s: true direction in the sensor frame, shape (k, 3); NaN for a false spot.
        is_swapped: True if a star has the identity of another star of its exposure, shape (k,).
    """

    rotation_nv: FloatArray
    hip: NDArray[np.int64]
    direction_s: FloatArray
    is_swapped: NDArray[np.bool_]


def simulate_sightings(
    source: str, config: StarImaging, motion: DeviceExposures, sky: TrueSky, draws: Draws
) -> tuple[StarSightings, SightingsTruth]:
    """Return all exposures of a star sensor or theodolite camera, and their truth.

    Exposures by day and in outages contain no stars.

    Args:
        source: begin of the names of the random streams.
        config: part of the scenario for the sensor or camera.
        motion: exposures and true attitude of the sensor or camera.
        sky: the true sky.
        draws: random draws of the run.
    """
    dark = sky.sun_elevation(motion.valid_ns) < np.deg2rad(config.sun_limit_deg)
    is_observing = dark & is_outside(motion.since_start_s, config.outages)
    true = _true_spots(source, config, motion, sky, is_observing, draws)
    spots = _in_readout_order([true, _false_spots(source, config, sky, is_observing, draws)])
    arrival = draws.stream(source + ".arrival")
    # The message field has single precision.
    sigma_px = float(np.float32(config.camera.centroid_sigma_px))
    hip, positions, position_sigma = _identities(config, sky, spots.claimed)
    camera = config.camera.camera(source)
    sightings = StarSightings(
        time_ns=motion.time_ns,
        log_time_ns=arrival_times(motion.time_ns, config.latency_s, config.jitter_s, arrival),
        first=np.searchsorted(spots.exposure, np.arange(motion.time_ns.size + 1)),
        pixel=spots.pixel,
        sigma_px=sigma_px,
        stars=ReportedStars(
            hip=hip,
            directions_s=camera.directions(spots.pixel),
            sigma=equivalent_sigma(camera.direction_covariance(spots.pixel, sigma_px)),
            positions=positions,
            position_sigma=position_sigma,
            magnitude=spots.magnitude.astype(np.float32).astype(float),
        ),
    )
    true_hip = np.where(spots.row == UNKNOWN, 0, sky.catalogue.hip[spots.row])
    swapped = (spots.row != UNKNOWN) & (spots.claimed != spots.row)
    return sightings, SightingsTruth(motion.rotation_nv, true_hip, spots.direction_s, swapped)


@dataclass(frozen=True)
class _Spots:
    """The spots of light on the detector, one entry per spot.

    ``exposure`` is the number of the exposure. ``row`` is the row of the true star in the catalogue, UNKNOWN for a
    false spot. ``claimed`` is the row of the reported identity, and ``magnitude`` is the measured magnitude.
    """

    exposure: NDArray[np.int64]
    row: NDArray[np.int64]
    claimed: NDArray[np.int64]
    direction_s: FloatArray
    pixel: FloatArray
    magnitude: FloatArray

    def __getitem__(self, rows: Any) -> "_Spots":
        return _Spots(*(getattr(self, field)[rows] for field in vars(self)))


def _true_spots(
    source: str,
    config: StarImaging,
    motion: DeviceExposures,
    sky: TrueSky,
    is_observing: NDArray[np.bool_],
    draws: Draws,
) -> _Spots:
    """Return stars with errors in their centroids and magnitudes, and some swapped identities."""
    field = stars_in_field(
        config, sky, motion.rotation_nv[is_observing], motion.valid_ns[is_observing], motion.since_start_s[is_observing]
    )
    exposure = np.flatnonzero(is_observing)[field.exposure]
    # Path of each star on the detector; the sky is fixed during the exposure.
    path_s = field.direction_s[None]
    if config.exposure_s > 0.0:
        place_n = (motion.rotation_nv[exposure] @ field.direction_s[..., None])[..., 0]
        path_s = np.einsum("mkji,kj->mki", motion.exposure_nv[:, exposure], place_n)
    detector = config.camera
    path = draw_optics(random_stream(draws.seed, source + ".optics"), detector, source).pixels(path_s)
    if detector.field_spatial_sigma_px or detector.pixel_spatial_sigma_px:
        errors = draws.persistent_draw(source + ".detector", lambda rng: DetectorErrors(rng, detector))
        path = path + errors.errors_at(path)
    noise_px = draws.stream(source + ".centroid").standard_normal(field.pixel.shape)
    magnitude_noise = draws.stream(source + ".magnitude").standard_normal(field.row.size)
    swaps = draws.stream(source + ".swaps")
    return _Spots(
        exposure=exposure,
        row=field.row,
        claimed=swap_identities(field.row, exposure, config.swapped_probability, swaps),
        direction_s=field.direction_s,
        pixel=centroids(
            motion.times, path, config.camera.psf_sigma_px, config.camera.centroid_sigma_px, noise_px
        ),
        magnitude=sky.catalogue.magnitude[field.row] + MAGNITUDE_SIGMA * magnitude_noise,
    )


def _false_spots(
    source: str, config: StarImaging, sky: TrueSky, is_observing: NDArray[np.bool_], draws: Draws
) -> _Spots:
    """Return spots anywhere on the detector, each with the identity of a random star within the magnitude limit."""
    name = source + ".false_stars"
    count = draws.stream(name).poisson(config.false_stars, is_observing.size) * is_observing
    total = int(count.sum())
    bright = sky.catalogue.rows_brighter_than(config.magnitude_limit)
    least, greatest = config.camera.edges_px
    return _Spots(
        exposure=np.repeat(np.arange(is_observing.size), count),
        row=np.full(total, UNKNOWN),
        claimed=draws.stream(name + ".claimed").choice(bright, total),
        direction_s=np.full((total, 3), np.nan),
        pixel=draws.stream(name + ".pixel").uniform(least, greatest, (total, 2)),
        magnitude=sky.catalogue.magnitude[draws.stream(name + ".magnitude").choice(bright, total)],
    )


def _in_readout_order(kinds: list[_Spots]) -> _Spots:
    """Return all spots in readout order, row after row, so that the order does not depend on the kind of a spot."""
    spots = _Spots(*(np.concatenate([getattr(kind, field) for kind in kinds]) for field in vars(kinds[0])))
    return spots[np.lexsort((spots.pixel[:, 1], spots.exposure))]


def _identities(
    config: StarImaging, sky: TrueSky, claimed: NDArray[np.int64]
) -> tuple[NDArray[np.int64], StarPositions, FloatArray]:
    """Return the reported HIP number and position of each star, and the error of the position."""
    catalogue, start_ns = sky.catalogue, sky.track.start_ns
    if config.identified and not config.direction_given:
        return (
            catalogue.hip[claimed],
            catalogue.at_j2000[claimed],
            catalogue.position_sigma_at(claimed, julian_year(start_ns)),
        )
    if config.identified:
        positions = position_of_date(catalogue.at_j2000[claimed], start_ns)
    else:
        positions = fixed_stars(*np.full((2, claimed.size), np.nan))
    return np.zeros_like(claimed), positions, np.full(claimed.size, _GIVEN_DIRECTION_SIGMA)


@dataclass(frozen=True)
class InertialSamples:
    """The attitudes of a sensor that solves for its attitude against the ICRS.

    Attributes:
        time_ns: stamps, increasing, shape (n,).
        log_time_ns: arrival times, in any order, shape (n,).
        rotation_cv: ICRS from sensor (forward, up, right) as measured, shape (n, 3, 3).
        noise_v: covariance of the error of each attitude, in the sensor frame, rad², shape (3, 3).
    """

    time_ns: np.ndarray
    log_time_ns: np.ndarray
    rotation_cv: FloatArray
    noise_v: FloatArray


def simulate_inertial_sensor(
    sensor_id: str, scenario: Scenario, motion: StarSensorMotion, sky: TrueSky, draws: Draws
) -> InertialSamples:
    """Return samples R_cv = R_nc^T L^T R_star exp(n), where L is the rotation due to refraction at the boresight.

    The sensor corrects aberration with the velocity of the Earth, but not refraction. Its attitude is therefore the
    attitude at which the same image would occur without air. There is no attitude while the Sun is above its limit, in
    an outage, or if the boresight is below the range of the refraction model.
    """
    config, name = scenario.star_sensors[sensor_id], f"star.{sensor_id}"
    sigma_v = config.noise_sigma_s
    noise_v = sigma_v * draws.stream(name + ".white").standard_normal((motion.time_ns.size, 3))
    arrival = draws.stream(name + ".arrival")
    log_time_ns = arrival_times(motion.time_ns, config.latency_s, config.jitter_s, arrival)
    rotation_nc = sky.rotation_horizon_from_icrs(motion.valid_ns)
    rotation_nv = np.swapaxes(sky.refraction_rotation(motion.rotation_nv[..., 0]), -1, -2) @ motion.rotation_nv
    rotation_cv = np.swapaxes(rotation_nc, -1, -2) @ rotation_nv @ exp_rotation(noise_v)
    dark = sky.sun_elevation(motion.valid_ns) < np.deg2rad(config.sun_limit_deg)
    kept = dark & is_outside(motion.since_start_s, config.outages) & np.isfinite(rotation_cv[:, 0, 0])
    return InertialSamples(motion.time_ns[kept], log_time_ns[kept], rotation_cv[kept], np.diag(sigma_v**2))
