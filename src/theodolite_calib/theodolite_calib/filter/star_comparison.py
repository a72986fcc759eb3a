"""Stars in a camera on the theodolite against the attitude that the filter's state predicts for it.

The camera s hangs on the main axis, and that on encoders, deformation and ship (:mod:`theodolite_calib.chain`):

    rotation_ns = exp(a) R_ship · exp(e) · R_axes · R(ΔA, ΔE, Δω)ᵀ

A star has no baseline, no lever, no N' and no terrestrial refraction: its direction in the horizon is that of the
catalogue with aberration and refraction, and the errors that all stars share are states
(:mod:`ship_attitude_star.sky.shared_states`). Which star a detection is, which stars are believed, and their residuals
are as in the ship's filter (:mod:`ship_attitude_star.stars.residuals`).
"""

from dataclasses import dataclass

import numpy as np

from ship_attitude_star.sky.shared_states import sky_rows
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.stars.camera_states import camera_rows
from ship_attitude_star.stars.residuals import StarResiduals, star_residuals
from ship_attitude_star.stars.scale_check import learned_contradiction
from ship_attitude_star.stars.selection import StarPrior
from ship_estimation.hypotheses import RowsCompared, compare_rows
from ship_estimation.kalman import LinearMeasurement, StateModel
from ship_estimation.refusals import Refusal
from ship_geometry.rotations import FloatArray
from theodolite_calib.chain.axes import axis_chain
from theodolite_calib.chain.parallelism import telescope_from_main
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.model import SOURCE_ENCODER, SOURCE_SHIP_NOISE, parallelism_block
from theodolite_calib.filter.prediction import SightingModel
from theodolite_calib.measured.star_sighting import StarSighting

_STEPS = 6
# What a step of this size (rad) leaves of the equations that is not linear is its square: below rounding.
_SMALL_STEP = 1e-5


@dataclass(frozen=True)
class CameraAttitude:
    """A camera's attitude as a state has it; n states.

    Attributes:
        rotation_ns: horizon from camera, shape (3, 3).
        turn_n: its rotation vector in n per state, shape (3, n).
        noise_n: covariance of that rotation vector that is new with each exposure, by source, rad², shape (3, 3).
    """

    rotation_ns: FloatArray
    turn_n: FloatArray
    noise_n: dict[str, FloatArray]

    def prior(self, covariance: FloatArray) -> StarPrior:
        """The same as the choice of stars takes it, by the covariance of the state, shape (n, n)."""
        noise_n: FloatArray = np.sum(list(self.noise_n.values()), axis=0)
        return StarPrior(self.rotation_ns, self.turn_n @ covariance @ self.turn_n.T + noise_n)


@dataclass(frozen=True)
class StarComparison:
    """Stars of an exposure beside a predicted state, linearised where the update leads; k stars.

    Attributes:
        camera: at the point of linearisation.
        stars: that are used, as they are seen from there.
        measurement: residual relative to the predicted mean, rad, shape (2 k,), with Jacobian and noise by source.
        rows: the comparison of it with the predicted state, as the only row.
    """

    camera: CameraAttitude
    stars: StarResiduals
    measurement: LinearMeasurement
    rows: RowsCompared


class StarModel:
    """How stars depend on the states, for a configuration.

    Args:
        config: the node's parameters.
        model: its states.
        sightings: how the main axis depends on them.
    """

    def __init__(self, config: OpticalAxisConfig, model: StateModel, sightings: SightingModel) -> None:
        self._model, self._sightings = model, sightings
        self._cameras = {
            id_: (camera.parallelism, parallelism_block(id_, config)) for id_, camera in config.telescopes.items()
        }
        shared = config.telescope.telescope_id
        self._lens_rows = {
            id_: camera_rows(model.slices, f"telescope.{id_}", "focal_length" if id_ == shared else "")
            for id_ in config.telescopes
        }
        # The errors of a lens are counted in sigmas, but the focal length that lights share is in metres.
        self._in_sigmas: FloatArray = np.ones(model.size)
        if shared in config.telescopes:
            lens = config.star_camera(shared)
            self._in_sigmas[model.slices["focal_length"]] = 1.0 / (lens.focal_sigma * lens.focal_length_m)
        self._sky_rows = sky_rows(model.slices, config.sky) if config.telescopes else slice(0, 0)

    def predict(self, mean: FloatArray, sighting: StarSighting) -> CameraAttitude:
        """The camera at the middle of an exposure as a state has it."""
        ship, encoder = sighting.ship, sighting.encoder
        errors = self._sightings.chain_errors(mean)
        chain = axis_chain(errors, ship.rotation_nd, ship.rate_d, encoder.azimuth, encoder.elevation)
        configured, block = self._cameras[sighting.camera_id]
        rotation_ns, by_angles = telescope_from_main(configured + mean[self._model.slices[block]], chain.rotation_nm)
        noise_n = {
            SOURCE_ENCODER: encoder.noise * (chain.by_encoder @ chain.by_encoder.T),
            SOURCE_SHIP_NOISE: ship.noise * np.eye(3),
        }
        return CameraAttitude(rotation_ns, self._sightings.turn_n(chain, by_angles, block), noise_n)

    def residuals(
        self,
        camera: CameraAttitude,
        mean: FloatArray,
        sighting: StarSighting,
        prior: StarPrior,
        watch: SkyWatch,
        near_ns: FloatArray | None = None,
    ) -> StarResiduals | Refusal:
        """The stars against the camera as a state has it; see :func:`star_residuals`."""
        to_camera = camera.rotation_ns.T @ camera.turn_n
        stars = star_residuals(
            sighting.exposure,
            camera.rotation_ns,
            to_camera,
            prior,
            watch,
            self._sky_rows,
            mean * self._in_sigmas,
            near_ns,
            self._lens_rows[sighting.camera_id],
        )
        if not isinstance(stars, Refusal):
            stars.jacobian[:] *= self._in_sigmas
        return stars

    def contradiction(self, mean: FloatArray, covariance: FloatArray, sighting: StarSighting) -> Refusal | None:
        """The rejection of an exposure by which its camera's focal length were far from the configured one.

        Args:
            mean: of the state after it, shape (n,).
            covariance: of that state, shape (n, n).
            sighting: the exposure.
        """
        rows, optics = self._lens_rows[sighting.camera_id], sighting.exposure.optics
        if rows is None or optics is None:
            return None
        in_sigmas = float(self._in_sigmas[rows[0]])
        variance = float(covariance[rows[0], rows[0]])
        return learned_contradiction(optics, in_sigmas * float(mean[rows[0]]), in_sigmas**2 * variance)

    def compare(
        self, mean: FloatArray, covariance: FloatArray, sighting: StarSighting, watch: SkyWatch
    ) -> StarComparison | Refusal:
        """Compare an exposure with a state predicted to its moment, or say why no star of it can be.

        The stars are linearised again where the update leads until that no longer moves (Gauss–Newton): the NIS is then
        the least sum of squares that any state can reach against prediction and stars together.

        Args:
            mean: of the predicted state, shape (n,).
            covariance: of the predicted state, shape (n, n).
            sighting: the exposure.
            watch: the sky.

        Raises:
            numpy.linalg.LinAlgError: the covariance of the residual is not positive definite.
        """
        camera = self.predict(mean, sighting)
        prior, reached, near_ns = camera.prior(covariance), mean, None
        for _ in range(_STEPS):
            stars = self.residuals(camera, reached, sighting, prior, watch, near_ns)
            if isinstance(stars, Refusal):
                return stars
            measurement = self._measurement(camera, stars, reached - mean)
            rows = compare_rows(mean[None], covariance[None], measurement, mean, stars.by_turn)
            found = StarComparison(camera, stars, measurement, rows)
            led = mean + rows.gain[0] @ measurement.residual
            if np.max(np.abs(camera.turn_n @ (led - reached))) < _SMALL_STEP:
                break
            reached, camera = led, self.predict(led, sighting)
            near_ns = camera.rotation_ns
        return found

    def _measurement(self, camera: CameraAttitude, stars: StarResiduals, moved: FloatArray) -> LinearMeasurement:
        """The stars as one Kalman step takes them, from a state that they are linearised ``moved`` away from."""
        by_turn_n = stars.by_turn @ camera.rotation_ns.T
        index = self._model.source_indices
        noise = {index[source]: by_turn_n @ part_n @ by_turn_n.T for source, part_n in camera.noise_n.items()}
        noise |= {index[source]: part for source, part in stars.noise.items()}
        return LinearMeasurement(stars.residual + stars.jacobian @ moved, stars.jacobian, noise)
