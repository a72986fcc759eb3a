"""A ship under the real sky, for tests: configuration, sky model, INS track, and exposures of real stars."""

from dataclasses import replace

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_estimation.parameters.schema import build
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_samples import PositionFix
from ship_stars.sky.catalogue import julian_year
from ship_stars.sky.sky_model import SkyModel, load_sky_model

TIME_NS = 1_404_906_607_800_000_000
"""2014-07-09 11:50:07.8 UTC, as in [P15]."""

POSITION = GeodeticPosition(np.deg2rad(31.945213), np.deg2rad(120.293086), 20.0)
ROTATION_ND = rotation_from_angles(*np.deg2rad([34.4, 1.0, -2.0]))
SENSORS = {
    "fore": {"azimuth_deg": 0.0, "elevation_deg": 45.0},
    "starboard": {"azimuth_deg": 90.0, "elevation_deg": 45.0},
}
SIGMA = 3.0 * ARCSEC
MAGNITUDE_LIMIT = 6.0
FIELD_DEG = 7.0


def configuration(**ship) -> ShipAttitudeConfig:
    sensors = {id_: {"input": "observations", **angles} for id_, angles in SENSORS.items()}
    return build(ShipAttitudeConfig, {"star_sensors": sensors, **ship})


def sky_at_anchor(config: ShipAttitudeConfig, sigma_m: float = 5.0) -> SkyModel:
    """Return the sky of a ship at anchor, with a fix each second from 2 s before TIME_NS to 59 s after it."""
    sky_model = load_sky_model(config.sky)
    for second in range(-2, 60):
        sky_model.surroundings.insert(PositionFix(TIME_NS + second * 1_000_000_000, POSITION, np.eye(3) * sigma_m**2))
    return sky_model


def ins_track(time_ns: int = TIME_NS, error_n: FloatArray | None = None) -> AttitudeTrack:
    """Return the track of an INS with a constant error on a ship that does not move."""
    rotation_nd = ROTATION_ND if error_n is None else exp_rotation(-error_n) @ ROTATION_ND
    track = AttitudeTrack(500_000_000)
    for step in range(-4, 5):
        track.insert(AttitudeSample(time_ns + step * 50_000_000, rotation_nd, np.zeros(3)))
    return track


def exposure_of(
    sky_model: SkyModel,
    id_: str,
    count: int,
    rng: np.random.Generator | None = None,
    time_ns: int = TIME_NS,
    installation_s: FloatArray | None = None,
) -> StarExposure:
    """Return the brightest stars in a sensor's field, with noise if ``rng`` is given."""
    catalogue = sky_model.catalogue
    rows = catalogue.rows_brighter_than(MAGNITUDE_LIMIT)
    apparent = sky_model.sky_at(time_ns).apparent_stars(catalogue.at_j2000[rows])
    angles = SENSORS[id_]
    rotation_ns = ROTATION_ND @ rotation_from_angles(*np.deg2rad([angles["azimuth_deg"], angles["elevation_deg"], 0.0]))
    if installation_s is not None:
        rotation_ns = rotation_ns @ exp_rotation(installation_s)
    directions_s = apparent.direction_n @ rotation_ns
    inside = np.flatnonzero(apparent.visible & (directions_s[:, 0] > np.cos(np.deg2rad(FIELD_DEG))))
    chosen = inside[np.argsort(catalogue.magnitude[rows[inside]])][:count]
    seen = directions_s[chosen]
    if rng is not None:
        seen = seen + SIGMA * rng.standard_normal(seen.shape)
        seen /= np.linalg.norm(seen, axis=-1, keepdims=True)
    kept = rows[chosen]
    return StarExposure(
        source=f"star.{id_}",
        time_ns=time_ns,
        hip=catalogue.hip[kept],
        directions_s=seen,
        sigma=np.full(len(kept), SIGMA),
        positions=catalogue.at_j2000[kept],
        position_sigma=catalogue.position_sigma_at(kept, julian_year(time_ns)),
        magnitude=catalogue.magnitude[kept],
    )


def without_identity(exposure: StarExposure) -> StarExposure:
    """Return the exposure as a sensor without a catalogue would send it: no HIP numbers and no positions."""
    unknown = np.full(len(exposure), np.nan)
    positions = replace(exposure.positions, right_ascension=unknown, declination=unknown)
    return replace(exposure, hip=np.zeros(len(exposure), dtype=np.int64), positions=positions)
