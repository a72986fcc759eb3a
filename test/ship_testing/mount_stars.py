"""Stars in a camera on the theodolite, with all errors drawn: exposures for the filter, and the true main axis.

The camera is that of [W18]: 100 mm, 6.5 µm pixels, centroids to a tenth of a pixel. The stars are real ones, within ±4°
of the camera's axis.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_simulation.stars.true_camera import DetectorErrors, TrueOptics
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.attitude_samples import AirReading, PositionFix
from ship_stars.camera.camera import StarCamera
from ship_stars.camera.errors import OpticsErrors, SpatialErrors
from ship_stars.sky.catalogue import julian_year
from ship_stars.sky.sky_model import SkyModel, load_sky_model
from ship_testing.simulated_session import SHIP_SIGMA_N, config
from ship_testing.star_sky import POSITION, ROTATION_ND, TIME_NS
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.samples.samples import EncoderSample
from theodolite_calib.samples.sighting import StarSighting
from theodolite_calib.samples.tracks import EncoderAt, ShipAt

CAMERA_ID = "night"
FIELD = np.deg2rad(4.0)
STAR_SIGMA = 0.1 * 6.5e-6 / 0.1
"""Sigma of a star: a tenth of a pixel, rad."""
CAMERA = {"focal_length_m": 0.1, "pixel_pitch_m": 6.5e-6, "principal_u_px": 1100.0, "principal_v_px": 1100.0}
MOUNTED_DEG = {"azimuth_deg": 0.2, "elevation_deg": -0.1, "roll_deg": 3.0}


def mount_config(parallelism_sigma_arcsec: float = 0.2, **changes) -> OpticalAxisConfig:
    """Return a theodolite with one camera for stars, with negligible noise of encoders and ship."""
    own = {f"telescopes__{CAMERA_ID}__camera__{name}": value for name, value in CAMERA.items()}
    own |= {f"telescopes__{CAMERA_ID}__{name}": value for name, value in MOUNTED_DEG.items()}
    own |= {
        f"telescopes__{CAMERA_ID}__{name}_sigma_arcsec": parallelism_sigma_arcsec
        for name in ("azimuth", "elevation", "roll")
    }
    quiet = {"encoder__sigma_arcsec": 0.05, "ship__white_sigma_arcsec": 0.05, "sky__magnitude_limit": 7.5}
    return config(**{**own, **quiet, **changes})


def mount_sky(settings: OpticalAxisConfig, start_ns: int = TIME_NS, seconds: int = 60) -> SkyModel:
    """Return the sky of a ship at anchor, with weather readings, and with position fixes for ``seconds``."""
    sky_model = load_sky_model(settings.sky)
    for reading in anchored_readings(start_ns, seconds):
        sky_model.surroundings.insert(reading)
    return sky_model


def anchored_readings(start_ns: int = TIME_NS, seconds: int = 60) -> Iterator[PositionFix | AirReading]:
    """Yield position and weather readings of a ship at anchor."""
    for second in range(-3, seconds):
        yield PositionFix(start_ns + second * 1_000_000_000, POSITION, np.eye(3) * 25.0)
    for quantity, value, sigma in (("pressure", 1013.0, 0.5), ("temperature", 12.0, 1.0), ("humidity", 0.7, None)):
        yield AirReading(quantity, start_ns - 3_000_000_000, value, sigma)


@dataclass(frozen=True)
class MountErrors:
    """Constant errors of one session: true minus configured.

    Attributes:
        axes: axis errors, rad, shape (7,).
        deformation_d: rotation vector, rad, shape (3,).
        ship_n: error of the ship's attitude, rotation vector, rad, shape (3,).
        parallelism: error of the camera's parallelism, rad, shape (3,).
        sky: errors that all stars share, in sigmas, shape (4,), or (5,) if ``sky.utc_sigma_s`` is positive.
    """

    axes: FloatArray
    deformation_d: FloatArray
    ship_n: FloatArray
    parallelism: FloatArray
    sky: FloatArray


def draw_errors(settings: OpticalAxisConfig, rng: np.random.Generator) -> MountErrors:
    """Draw errors with the sigmas of the configuration."""
    return MountErrors(
        axes=settings.axes.sigma * rng.standard_normal(7),
        deformation_d=settings.deformation.sigma_arcsec * ARCSEC * rng.standard_normal(3),
        ship_n=SHIP_SIGMA_N * rng.standard_normal(3),
        parallelism=settings.telescopes[CAMERA_ID].parallelism_sigma * rng.standard_normal(3),
        sky=rng.standard_normal(5 if settings.sky.utc_sigma_s > 0.0 else 4),
    )


def observe_stars(
    sky_model: SkyModel,
    rotation_ns: FloatArray,
    sky_errors: FloatArray,
    count: int,
    rng: np.random.Generator,
    time_ns: int,
    camera_id: str = CAMERA_ID,
    spatial: SpatialErrors | None = None,
    detector: DetectorErrors | None = None,
    lens: TrueOptics | None = None,
    optics: OpticsErrors | None = None,
) -> StarExposure:
    """Return ``count`` stars of the field: random ones, or the brightest if ``detector`` or ``lens`` is given.

    Args:
        sky_model: the sky.
        rotation_ns: true attitude of the camera (horizon from camera), shape (3, 3).
        sky_errors: errors that all stars share, in sigmas.
        count: number of stars.
        rng: random numbers of the noise and of the selection.
        time_ns: middle of the exposure.
        camera_id: id of the camera.
        spatial: model of the detector's position-dependent errors.
        detector: true position-dependent errors of the detector; None for none.
        lens: true optics of the camera; None for the configured optics.
        optics: model of the errors of the lens.
    """
    sky_at_time, catalogue = sky_model.sky_at(time_ns), sky_model.catalogue
    rows = sky_at_time.bright_rows_around(rotation_ns[:, 0], 1.5 * FIELD)
    apparent = sky_at_time.apparent_stars(catalogue.at_j2000[rows])
    seen_s = (apparent.direction_n + apparent.shared_n @ sky_errors) @ rotation_ns
    inside = np.flatnonzero(np.all(np.abs(seen_s[:, 1:] / seen_s[:, :1]) < np.tan(FIELD), axis=-1))
    brightest = inside[np.argsort(catalogue.magnitude[rows[inside]], kind="stable")]
    kept = (rng.permutation(inside) if detector is None and lens is None else brightest)[:count]
    if len(kept) < count:
        raise ValueError(f"{len(kept)} stars in the field: expected {count}")
    seen_s = seen_s[kept]
    camera = StarCamera(**CAMERA)
    if lens is not None:
        seen_s = camera.directions(lens.pixels(seen_s))
    if detector is not None:
        pixels = camera.pixels(seen_s)
        seen_s = camera.directions(pixels + detector.errors_at(pixels))
    seen_s = seen_s + STAR_SIGMA * rng.standard_normal(seen_s.shape)
    rows = rows[kept]
    return StarExposure(
        source=f"star.{camera_id}",
        time_ns=time_ns,
        hip=catalogue.hip[rows],
        directions_s=seen_s / np.linalg.norm(seen_s, axis=-1, keepdims=True),
        sigma=np.full(len(kept), STAR_SIGMA),
        positions=catalogue.at_j2000[rows],
        position_sigma=catalogue.position_sigma_at(rows, julian_year(time_ns)),
        magnitude=catalogue.magnitude[rows],
        spatial=spatial,
        optics=optics,
    )


class MountSession:
    """One session of a theodolite on a ship that does not move.

    Args:
        settings: configuration, with the sigmas of the noise.
        errors: constant errors.
        sky_model: the sky.
        rng: random numbers of the noise.
        detector: position-dependent errors of the camera's detector; None for none.
    """

    def __init__(
        self,
        settings: OpticalAxisConfig,
        errors: MountErrors,
        sky_model: SkyModel,
        rng: np.random.Generator,
        detector: DetectorErrors | None = None,
    ) -> None:
        self.settings, self.errors, self.sky_model, self.rng = settings, errors, sky_model, rng
        self.detector = detector

    def main_axis(self, encoder: FloatArray) -> FloatArray:
        """Return the true main axis (horizon from main frame) at true encoder angles, rad, shape (3, 3)."""
        axes = AxisErrors.from_vector(self.settings.axes.values + self.errors.axes)
        turned = ROTATION_ND @ exp_rotation(self.errors.deformation_d)
        return turned @ main_axis_rotation(axes, *encoder.tolist())

    def ship(self) -> ShipAt:
        """Return the ship's attitude as input of the filter."""
        white = self.settings.ship.white_sigma_arcsec * ARCSEC
        turn = self.errors.ship_n + white * self.rng.standard_normal(3)
        return ShipAt(exp_rotation(turn).T @ ROTATION_ND, np.zeros(3), np.diag(SHIP_SIGMA_N**2), white**2)

    def reading(self, encoder: FloatArray, time_ns: int = TIME_NS) -> EncoderSample:
        """Return the readings of the encoders."""
        sigma = self.settings.encoder.sigma_arcsec * ARCSEC
        return EncoderSample(time_ns, encoder + sigma * self.rng.standard_normal(2), sigma)

    def exposure(self, encoder: FloatArray, count: int, time_ns: int = TIME_NS) -> StarExposure:
        """Return ``count`` measured stars of the field: random ones, or the brightest if there is a ``detector``."""
        camera = self.settings.telescopes[CAMERA_ID]
        rotation_sm = rotation_from_angles(*(camera.parallelism + self.errors.parallelism))
        rotation_ns = self.main_axis(encoder) @ rotation_sm.T
        optics = camera.camera.optics_errors(camera.camera.camera(CAMERA_ID))
        spatial = camera.camera.spatial_errors(camera.camera.camera(CAMERA_ID))
        return observe_stars(
            self.sky_model,
            rotation_ns,
            self.errors.sky,
            count,
            self.rng,
            time_ns,
            spatial=spatial,
            detector=self.detector,
            optics=optics,
        )

    def sighting(self, encoder: FloatArray, count: int, time_ns: int = TIME_NS) -> StarSighting:
        """Return an exposure of ``count`` stars with the ship's attitude and the encoder angles."""
        angles = self.reading(encoder).vector
        variance = (self.settings.encoder.sigma_arcsec * ARCSEC) ** 2
        exposure = self.exposure(encoder, count, time_ns)
        return StarSighting(CAMERA_ID, exposure, self.ship(), EncoderAt(*angles.tolist(), variance))


def random_field(rng: np.random.Generator) -> FloatArray:
    """Return random encoder angles with elevations from 35° to 80°, rad, shape (2,)."""
    return np.array([rng.uniform(0.0, 2.0 * np.pi), np.deg2rad(rng.uniform(35.0, 80.0))])
