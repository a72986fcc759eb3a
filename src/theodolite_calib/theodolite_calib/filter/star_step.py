"""Filter step with one exposure of stars: comparison with the predicted attitude of the camera, gate and update.

The state is propagated to the time of the exposure and compared with the identified stars. The camera s is fixed to the
main axis. The attitude of the camera follows from encoders, deformation and ship (:mod:`ship_geometry.mount.axes`):

    rotation_ns = exp(a) R_ship · exp(e) · R_axes · R(ΔA, ΔE, Δω)ᵀ

A star has no baseline, lever, N' or terrestrial refraction. The direction of a star in the horizon is the catalogue
direction with aberration and refraction. Errors common to all stars are states (:mod:`ship_stars.sky.sky_model`). The
ship's filter uses the same identification, rejection and residuals of stars
(:mod:`ship_stars.attitude_from_stars.residuals`).

If the stars pass the gate of the main filter, the main filter is updated. Each subfilter is then updated if the stars
pass the gate of this subfilter. Stars that contradict encoders and ship are counted together with rejected beacons. The
pointing is then DEGRADED until stars or beacons are accepted again.
"""

from dataclasses import dataclass, replace

import numpy as np

from ship_estimation.fault_detection.subfilters import FilterInnovations, subfilter_innovations
from ship_estimation.innovations.gates import chi_square_gate
from ship_estimation.kalman.kalman_filter import LinearMeasurement, StateModel
from ship_estimation.rejection_rules import Reason, Rejection, singular_covariance
from ship_geometry.mount.axes import axis_geometry, telescope_rotation
from ship_geometry.rotations import FloatArray
from ship_stars.attitude_from_stars.field_scale import check_estimated_focal_length
from ship_stars.attitude_from_stars.residuals import PredictedSensor, StarResiduals, star_residuals
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.camera.config import camera_state_indices
from ship_stars.sky.sky_model import SkyModel, sky_slice
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.fault_detection import record_acceptance
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import SOURCE_ENCODER, SOURCE_SHIP_NOISE, axis_state_indices, parallelism_block
from theodolite_calib.filter.prediction import SightingModel
from theodolite_calib.filter.step import count_rejection, solution_separations
from theodolite_calib.filter.subfilters import AXIS_SOURCES
from theodolite_calib.samples.samples import ExposureDecision
from theodolite_calib.samples.sighting import StarSighting

_CONFLICT_REASONS = (Reason.UNIDENTIFIED, Reason.MISIDENTIFIED)
"""Reasons for which a rejection of stars contradicts the prediction: a correct prediction identifies most stars."""

_STEPS = 6
# Step size, rad, below which the non-linear remainder, of the order of the step squared, is negligible.
_SMALL_STEP = 1e-5


@dataclass(frozen=True)
class CameraAttitude:
    """Attitude of a camera predicted from a state of n errors.

    Attributes:
        rotation_ns: horizon from camera, shape (3, 3).
        by_state_n: derivatives of the camera's rotation vector in n with respect to the states, shape (3, n).
        noise_n: covariance of the attitude's white error, by source, rad², shape (3, 3).
    """

    rotation_ns: FloatArray
    by_state_n: FloatArray
    noise_n: dict[str, FloatArray]

    def prior(self, covariance: FloatArray) -> StarPrior:
        """Return the prior for the selection of stars, from the covariance of the state, shape (n, n)."""
        noise_n: FloatArray = np.sum(list(self.noise_n.values()), axis=0)
        return StarPrior(self.rotation_ns, self.by_state_n @ covariance @ self.by_state_n.T + noise_n)


@dataclass(frozen=True)
class StarComparison:
    """Comparison of k stars of an exposure with a propagated state, linearised at the updated state.

    Attributes:
        camera: camera's attitude at the updated state.
        stars: accepted stars, with residuals at the updated state.
        measurement: residual relative to the propagated mean, rad, shape (2 k,), with Jacobian and noise by source.
        innovations: innovation of the propagated state, as :class:`FilterInnovations` of one filter.
    """

    camera: CameraAttitude
    stars: StarResiduals
    measurement: LinearMeasurement
    innovations: FilterInnovations


class StarStep:
    """Filter step from one state to the next for one exposure of stars.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
        sky: sky model.

    Attributes:
        stars: measurement model of the stars.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter, sky: SkyModel) -> None:
        self._filter, self._gate, self._sky = filter_, config.gate, sky
        self.stars = StarModel(config, filter_.model, filter_.sightings)
        self._return_after_s = config.integrity.return_after_s
        self._axis_indices = axis_state_indices(filter_.model)

    def __call__(self, state: CalibrationState, sighting: StarSighting) -> tuple[CalibrationState, ExposureDecision]:
        """Return state and decision after an exposure; ``state`` is the state after the previous beacons or stars."""
        after, decision = self._evaluate(state, sighting)
        return after, replace(decision, excluded_sources=tuple(sorted(after.fault_state.excluded)))

    def _evaluate(self, state: CalibrationState, sighting: StarSighting) -> tuple[CalibrationState, ExposureDecision]:
        predicted = self._filter.propagate(state, sighting.time_ns, sighting.ship.correlated_covariance_n)
        predicted = self._filter.add_unknown_errors(predicted)
        exposure = sighting.exposure.with_pixel_dwell(state.pixel_dwells.get(sighting.exposure.source))
        sighting = replace(sighting, exposure=exposure)
        try:
            comparison = self.stars.compare(predicted.mean, predicted.covariance, sighting, self._sky)
            if not isinstance(comparison, Rejection):
                return self._gate_and_update(state, predicted, sighting, comparison)
        except np.linalg.LinAlgError:
            comparison = singular_covariance()
        decision = ExposureDecision(sighting.exposure, comparison.reason, text=comparison.text)
        # If encoders or ship are excluded, the prediction is unknown and stars cannot contradict it.
        if comparison.reason in _CONFLICT_REASONS and not state.fault_state.excluded.keys() & AXIS_SOURCES:
            return count_rejection(state, decision, self._gate, "stars")
        return state, decision

    def _gate_and_update(
        self, state: CalibrationState, predicted: CalibrationState, sighting: StarSighting, comparison: StarComparison
    ) -> tuple[CalibrationState, ExposureDecision]:
        measurement, innovations = comparison.measurement, comparison.innovations
        (covariance,), (nis,), (gain,) = innovations.covariance, innovations.nis.tolist(), innovations.gain
        gate = chi_square_gate(self._gate.probability, len(measurement.residual))
        decision = ExposureDecision(
            measurement=sighting.exposure,
            reason=Reason.GATE,
            components=comparison.stars.components,
            residual=measurement.residual,
            sigma=np.sqrt(np.diagonal(covariance)),
            covariance=covariance,
            noise=measurement.noise,
            nis=nis,
            gate=gate,
            rejected_parts=comparison.stars.rejected,
        )
        # The condition is written so that NaN fails.
        if not nis <= gate:
            decision = replace(decision, text=f"NIS {nis:.1f} exceeds gate {gate:.1f}")
            return count_rejection(state, decision, self._gate, "stars")
        after = self._filter.update_by_stars(predicted, sighting.exposure, measurement, gain)
        contradiction = self.stars.optics_rejection(after.mean, after.covariance, sighting)
        if contradiction is not None:
            decision = replace(decision, reason=contradiction.reason, text=contradiction.text)
            return count_rejection(state, decision, self._gate, "stars")
        subfilters = self._filter.subfilters.update_by_stars(
            predicted.subfilters,
            measurement,
            predicted.mean,
            comparison.stars.rotation_jacobian,
            self._gate.probability,
        )
        separation = solution_separations(
            after, subfilters, self._axis_indices, comparison.camera.rotation_ns, comparison.camera.by_state_n
        )
        fault_state = record_acceptance(predicted.fault_state, sighting.time_ns, self._return_after_s)
        after = replace(after, subfilters=subfilters, solution_separation=separation, fault_state=fault_state)
        return after, replace(decision, reason=Reason.NONE, accepted=True)


class StarModel:
    """Measurement model of stars for a configuration.

    Args:
        config: parameters of the node.
        model: states of the filter.
        sightings: measurement model of the main axis.
    """

    def __init__(self, config: OpticalAxisConfig, model: StateModel, sightings: SightingModel) -> None:
        self._model, self._sightings = model, sightings
        self._cameras = {
            id_: (camera.parallelism, parallelism_block(id_, config)) for id_, camera in config.telescopes.items()
        }
        shared = config.telescope.telescope_id
        self._lens_indices = {
            id_: camera_state_indices(model.slices, f"telescope.{id_}", "focal_length" if id_ == shared else "")
            for id_ in config.telescopes
        }
        # Errors of the optics are in sigmas, except for the focal length shared with the beacons, which is in metres.
        self._in_sigmas: FloatArray = np.ones(model.size)
        if shared in config.telescopes:
            lens = config.star_camera(shared)
            self._in_sigmas[model.slices["focal_length"]] = 1.0 / (lens.focal_sigma * lens.focal_length_m)
        self._sky_indices = sky_slice(model.slices)

    def predict(self, mean: FloatArray, sighting: StarSighting) -> CameraAttitude:
        """Return the camera's attitude at the middle of an exposure, predicted from a state."""
        ship, encoder = sighting.ship, sighting.encoder
        errors = self._sightings.geometry_errors(mean)
        geometry = axis_geometry(errors, ship.rotation_nd, ship.rate_d, encoder.azimuth, encoder.elevation)
        configured, block = self._cameras[sighting.camera_id]
        rotation_ns, by_angles = telescope_rotation(configured + mean[self._model.slices[block]], geometry.rotation_nm)
        noise_n = {
            SOURCE_ENCODER: encoder.noise * (geometry.by_encoder @ geometry.by_encoder.T),
            SOURCE_SHIP_NOISE: ship.noise * np.eye(3),
        }
        return CameraAttitude(rotation_ns, self._sightings.by_state_n(geometry, by_angles, block), noise_n)

    def residuals(
        self,
        camera: CameraAttitude,
        mean: FloatArray,
        sighting: StarSighting,
        prior: StarPrior,
        sky: SkyModel,
        nearby_rotation_ns: FloatArray | None = None,
    ) -> StarResiduals | Rejection:
        """Return the residuals of the stars, or a rejection; see :func:`star_residuals`."""
        to_camera = camera.rotation_ns.T @ camera.by_state_n
        stars = star_residuals(
            sighting.exposure,
            PredictedSensor(camera.rotation_ns, to_camera, mean * self._in_sigmas),
            prior,
            sky,
            self._sky_indices,
            nearby_rotation_ns,
            self._lens_indices[sighting.camera_id],
        )
        if not isinstance(stars, Rejection):
            stars.jacobian[:] *= self._in_sigmas
        return stars

    def optics_rejection(self, mean: FloatArray, covariance: FloatArray, sighting: StarSighting) -> Rejection | None:
        """Return the rejection if the focal length after an exposure is far from the configured value, or None.

        Args:
            mean: mean of the state updated by the exposure, shape (n,).
            covariance: covariance of the updated state, shape (n, n).
            sighting: the exposure.
        """
        rows, optics = self._lens_indices[sighting.camera_id], sighting.exposure.optics
        if rows is None or optics is None:
            return None
        in_sigmas = float(self._in_sigmas[rows[0]])
        variance = float(covariance[rows[0], rows[0]])
        return check_estimated_focal_length(optics, in_sigmas * float(mean[rows[0]]), in_sigmas**2 * variance)

    def compare(
        self, mean: FloatArray, covariance: FloatArray, sighting: StarSighting, sky: SkyModel
    ) -> StarComparison | Rejection:
        """Compare an exposure with a state at the same time, or return the reason why no star is usable.

        The stars are linearised until the updated state converges, at most six times (Gauss–Newton). The NIS is then
        the minimum, over all states, of a sum: the normalised squares of the star residuals and of the difference from
        the prediction.

        Args:
            mean: mean of the propagated state, shape (n,).
            covariance: covariance of the propagated state, shape (n, n).
            sighting: the exposure.
            sky: sky model.

        Raises:
            numpy.linalg.LinAlgError: the covariance of the residual is not positive definite.
        """
        camera = self.predict(mean, sighting)
        prior, reached, nearby_rotation_ns = camera.prior(covariance), mean, None
        for _ in range(_STEPS):
            stars = self.residuals(camera, reached, sighting, prior, sky, nearby_rotation_ns)
            if isinstance(stars, Rejection):
                return stars
            measurement = self._measurement(camera, stars, reached - mean)
            innovations = subfilter_innovations(
                mean[None], covariance[None], measurement, mean, stars.rotation_jacobian
            )
            found = StarComparison(camera, stars, measurement, innovations)
            updated = mean + innovations.gain[0] @ measurement.residual
            if np.max(np.abs(camera.by_state_n @ (updated - reached))) < _SMALL_STEP:
                break
            reached, camera = updated, self.predict(updated, sighting)
            nearby_rotation_ns = camera.rotation_ns
        return found

    def _measurement(self, camera: CameraAttitude, stars: StarResiduals, offset: FloatArray) -> LinearMeasurement:
        """Return the stars as one measurement, linearised at the propagated mean plus ``offset``."""
        by_turn_n = stars.rotation_jacobian @ camera.rotation_ns.T
        index = self._model.source_indices
        noise = {index[source]: by_turn_n @ part_n @ by_turn_n.T for source, part_n in camera.noise_n.items()}
        noise |= {index[source]: part for source, part in stars.noise.items()}
        return LinearMeasurement(stars.residual + stars.jacobian @ offset, stars.jacobian, noise)
