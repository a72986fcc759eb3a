"""Calibration filter: propagation of a state, comparison with a sighting, and update of the state.

The filter has no state between calls. A :class:`CalibrationState` is never changed in place, so the time-ordered log
can keep every state and return to it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from ship_estimation.fault_detection.subfilters import subfilter_innovations
from ship_estimation.kalman.kalman_filter import LinearMeasurement, propagate_covariance, update
from ship_estimation.plausibility.checked_ins import InsJump
from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import FloatArray
from ship_stars.attitude_from_stars.exposure import StarExposure
from ship_stars.camera.errors import PixelDwell
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.fault_detection import AxisFaultState, initial_fault_state
from theodolite_calib.filter.model import SOURCE_AXES, SOURCE_SHIP, ShipErrorProcess, state_model
from theodolite_calib.filter.observability import SightingObservability
from theodolite_calib.filter.prediction import Prediction, SightingModel
from theodolite_calib.filter.subfilters import AxisSubfilters, SubfilterStates
from theodolite_calib.samples.encoder_check import EncoderJump
from theodolite_calib.samples.sighting import Sighting

Jump = EncoderJump | InsJump

_NO_DWELLS: MappingProxyType[str, PixelDwell] = MappingProxyType({})

_STEPS = 5
# Step size, rad, below which the non-linear remainder, of the order of the step squared, is negligible.
_SMALL_STEP = 1e-5


@dataclass(frozen=True)
class CalibrationState:
    """State of the filter after its last sighting.

    Attributes:
        time_ns: time of the state; None before the first sighting or jump of the INS.
        mean: estimated errors, shape (..., n), mostly (n,).
        covariance_by_source: covariance of the estimate by error source, shape (..., n_sources, n, n).
        observability: root of the covariance from the sightings alone (:mod:`theodolite_calib.filter.observability`).
        subfilters: states of the subfilters.
        fault_state: excluded sources and unresolved faults.
        solution_separation: solution separation of each subfilter in the pointing of the last accepted sighting, in
            standard deviations, shape (h,); zeros after the exclusion of a source with a subfilter.
        ship_covariance_n: stated covariance of the ship's error, rad², shape (3, 3); None if the messages state none.
        consecutive_rejections: number of consecutive sightings, of beacons or stars, that were rejected because they
            contradict encoders and ship, or one another.
        rejection_text: text of the last rejection counted in ``consecutive_rejections``.
        last_beacons_ns: time of the last accepted sighting of beacons; None before the first.
        light_count: number of beacons in the last accepted sighting of beacons.
        last_stars_ns: time of the last accepted exposure of stars; None before the first.
        pixel_dwells: pixel dwell of the stars in each camera with errors per pixel; empty after a jump, or after the
            exclusion of a source with a subfilter.
        sighting_count: number of accepted sightings, of beacons and of stars.
        point_count: number of beacons and stars in the accepted sightings.
        residual_square_sum: sum of the squares of the residuals of beacons and stars on the sky, rad².
    """

    time_ns: int | None
    mean: FloatArray
    covariance_by_source: FloatArray
    observability: FloatArray
    subfilters: SubfilterStates
    fault_state: AxisFaultState
    solution_separation: FloatArray
    ship_covariance_n: FloatArray | None = None
    consecutive_rejections: int = 0
    rejection_text: str = ""
    last_beacons_ns: int | None = None
    light_count: int = 0
    last_stars_ns: int | None = None
    pixel_dwells: MappingProxyType[str, PixelDwell] = field(default_factory=lambda: _NO_DWELLS)
    sighting_count: int = 0
    point_count: int = 0
    residual_square_sum: float = 0.0

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the errors, shape (..., n, n)."""
        total: FloatArray = self.covariance_by_source.sum(axis=-3)
        return total

    @property
    def last_update_ns(self) -> int | None:
        """Time of the last accepted sighting, of beacons or of stars; None before the first."""
        return max(
            (time_ns for time_ns in (self.last_beacons_ns, self.last_stars_ns) if time_ns is not None), default=None
        )

    @property
    def residual_rms(self) -> float:
        """RMS of the residuals of beacons and stars on the sky, rad; NaN before the first accepted sighting."""
        return float(np.sqrt(self.residual_square_sum / self.point_count)) if self.point_count else float("nan")


@dataclass(frozen=True)
class Comparison:
    """Comparison of a sighting with its prediction, linearised.

    Attributes:
        prediction: predicted sighting.
        measurement: residual relative to the propagated state, m, with Jacobian and noise.
        covariance: covariance of the residual, m², shape (2 N, 2 N).
        nis: normalised innovation squared.
        angles_nis: part of ``nis`` due to the angles between the beacons, which no attitude of the telescope explains.
        gain: Kalman gain, shape (n, 2 N).
    """

    prediction: Prediction
    measurement: LinearMeasurement
    covariance: FloatArray
    nis: float
    angles_nis: float
    gain: FloatArray

    @property
    def focal_length_m(self) -> float:
        """Focal length of the prediction, m."""
        return float(self.prediction.camera.focal_length_m)


class CalibrationFilter:
    """Kalman filter of a configuration: propagation and measurement update of its states.

    Args:
        config: parameters of the node.
    """

    def __init__(self, config: OpticalAxisConfig) -> None:
        self.model = state_model(config)
        self.sightings = SightingModel(config, self.model)
        self.observability = SightingObservability(self.model, includes_lens=bool(config.telescopes))
        self.ship_error = ShipErrorProcess(config, self.model)
        self.subfilters = AxisSubfilters(config, self.model, self.ship_error)

    def initial_state(self) -> CalibrationState:
        """Return the state before any sighting, with the configured errors."""
        return self.initial_state_from(np.zeros(self.model.size), self.model.initial_covariance_by_source())

    def initial_state_from(self, mean: FloatArray, covariance_by_source: FloatArray) -> CalibrationState:
        """Return the state before any sighting, with given errors, shape (n,), and covariance, (n_sources, n, n)."""
        subfilters = self.subfilters.initial_states(mean, covariance_by_source.sum(axis=0))
        solution_separation = np.zeros(len(self.subfilters.names))
        return CalibrationState(
            None,
            mean,
            covariance_by_source,
            self.observability.initial_root(),
            subfilters,
            initial_fault_state(self.subfilters),
            solution_separation,
        )

    def propagate(
        self, state: CalibrationState, time_ns: int, new_ship_covariance_n: FloatArray | None
    ) -> CalibrationState:
        """Propagate the state to a later time.

        Args:
            state: state after the previous sighting.
            time_ns: later time; an earlier time does not change the state's time.
            new_ship_covariance_n: stated covariance of the ship's error at ``time_ns``, rad², shape (3, 3); None if the
                messages state none.
        """
        dt_s = 0.0 if state.time_ns is None else max(time_ns - state.time_ns, 0) * 1e-9
        decay, noise = self.model.transition(dt_s)
        parts = propagate_covariance(state.covariance_by_source, decay, noise, self.model.source_of)
        mean, ship_covariance_n, ship = decay * state.mean, state.ship_covariance_n, self.ship_error.columns
        mean[..., ship] = self.ship_error.propagate(state.mean[..., ship], decay[ship])
        step = self.ship_error.apply_stated_covariance(
            mean, parts, decay[ship], ship_covariance_n, new_ship_covariance_n
        )
        unaided = self.observability.propagate(state.observability, dt_s, ship_covariance_n)
        if step is not None:
            unaided = self.observability.with_ship_step(unaided, step)
        return replace(
            state,
            time_ns=time_ns if state.time_ns is None else max(time_ns, state.time_ns),
            mean=mean,
            covariance_by_source=parts,
            observability=unaided,
            subfilters=self.subfilters.propagate(state.subfilters, time_ns, new_ship_covariance_n),
            ship_covariance_n=new_ship_covariance_n,
        )

    def inflate_covariance(self, state: CalibrationState, jump: Jump) -> CalibrationState:
        """Inflate the covariance of the INS's correlated error, or of the encoders' zero points, after a jump."""
        if isinstance(jump, InsJump):
            state = self.propagate(state, jump.time_ns, None)
            states, source, covariance = self.model.state_indices("ship.attitude"), SOURCE_SHIP, jump.covariance_n
        else:
            first_axis = self.model.slices["axes"].start
            states, source = first_axis + np.array([NAMES.index("g"), NAMES.index("h")]), SOURCE_AXES
            covariance = np.outer(jump.jump, jump.jump) + jump.sigma_rad**2 * np.eye(2)
        parts = state.covariance_by_source.copy()
        parts[..., self.model.sources.index(source), states[:, None], states] += covariance
        subfilters = self.subfilters.inflate_covariance(state.subfilters, states, covariance)
        return replace(state, covariance_by_source=parts, subfilters=subfilters, pixel_dwells=_NO_DWELLS)

    def exclude_source(self, state: CalibrationState, source: str) -> CalibrationState:
        """Exclude a source: all filters restart from the subfilter without this source.

        The telescope has no subfilter. If the telescope is excluded, all filters restart from the main filter, which
        has rejected the sighting.
        """
        if source not in self.subfilters.names:
            subfilters = self.subfilters.restart_from_estimate(state.subfilters, state.mean, state.covariance)
            return replace(state, subfilters=subfilters)
        subfilters, row = state.subfilters, self.subfilters.names.index(source)
        mean, covariance = subfilters.mean[row], subfilters.covariances[row, 0]
        return replace(
            state,
            mean=mean,
            covariance_by_source=_parts_for_covariance(state.covariance_by_source, covariance),
            subfilters=self.subfilters.restart_from_estimate(subfilters, mean, covariance),
            solution_separation=np.zeros_like(state.solution_separation),
            pixel_dwells=_NO_DWELLS,
        )

    def add_unknown_errors(self, state: CalibrationState) -> CalibrationState:
        """Add the unknown error changes of excluded sources to all filters, before a sighting.

        Each subfilter also gets the unknown error change of the source that it excludes.
        """
        excluded, parts = state.fault_state.excluded.keys(), state.covariance_by_source
        if excluded:
            parts = parts.copy()
            self.subfilters.add_unknown_changes(parts, self.model.sources.index(SOURCE_AXES), excluded)
        subfilters = self.subfilters.add_unknown_errors(state.subfilters, excluded)
        return replace(state, covariance_by_source=parts, subfilters=subfilters)

    def align_unknown_errors(self, state: CalibrationState, sighting: Sighting) -> CalibrationState:
        """Set the unknown errors (:meth:`add_unknown_errors`) to the values that a sighting gives.

        These errors may reach degrees, which is too large for the linearised gate. The previous values have no weight,
        because their covariance is large.
        """
        comparison = self.compare(state, sighting)
        if comparison is None:
            return state
        after, _ = self.update_by_beacons(state, sighting, comparison)
        states = self.subfilters.unknown_states(state.fault_state.excluded.keys())
        mean, subfilter_means = state.mean.copy(), state.subfilters.mean.copy()
        mean[states] = subfilter_means[:, states] = after.mean[states]
        return replace(state, mean=mean, subfilters=replace(state.subfilters, mean=subfilter_means))

    def compare(self, state: CalibrationState, sighting: Sighting) -> Comparison | None:
        """Compare a sighting with a state at the same time; return None if a beacon would be behind the telescope."""
        prediction = self.sightings.predict(state.mean, sighting)
        if not np.all(np.isfinite(prediction.residual)):
            return None
        return self._comparison(state, prediction, prediction.residual)

    def update_by_beacons(
        self, state: CalibrationState, sighting: Sighting, comparison: Comparison
    ) -> tuple[CalibrationState, Comparison]:
        """Update the propagated main filter with a sighting; return the new state and the last iteration's comparison.

        The sighting is linearised again at the new estimate until the estimate converges, in at most five iterations
        (Gauss–Newton). More than one iteration is needed only if the sighting is far from the prediction.
        """
        latest, mean = comparison, state.mean
        for _ in range(_STEPS):
            correction, parts = update(state.covariance_by_source, latest.measurement, latest.gain)
            rotation_step = latest.prediction.by_state_n @ (state.mean + correction - mean)
            mean = state.mean + correction
            if np.max(np.abs(rotation_step)) < _SMALL_STEP:
                break
            prediction = self.sightings.predict(mean, sighting)
            latest = self._comparison(state, prediction, prediction.residual + prediction.jacobian @ correction)
        on_sky = comparison.measurement.residual / comparison.focal_length_m
        after = self._after_update(state, mean, parts, latest.measurement, on_sky)
        return replace(after, last_beacons_ns=sighting.time_ns, light_count=len(sighting.names)), latest

    def update_by_stars(
        self, state: CalibrationState, exposure: StarExposure, measurement: LinearMeasurement, gain: FloatArray
    ) -> CalibrationState:
        """Update the propagated state with an exposure of stars; the subfilters are not changed.

        Args:
            state: propagated state.
            exposure: exposure of the stars.
            measurement: residual of the stars relative to the propagated state, rad, with Jacobian and noise.
            gain: Kalman gain, shape (n, 2 k).
        """
        pixel_dwells = state.pixel_dwells
        if exposure.pixel_dwell is not None:
            pixel_dwells = MappingProxyType({**pixel_dwells, exposure.source: exposure.pixel_dwell})
        correction, parts = update(state.covariance_by_source, measurement, gain)
        after = self._after_update(state, state.mean + correction, parts, measurement, measurement.residual)
        return replace(after, last_stars_ns=exposure.time_ns, pixel_dwells=pixel_dwells)

    def _after_update(
        self,
        state: CalibrationState,
        mean: FloatArray,
        parts: FloatArray,
        measurement: LinearMeasurement,
        on_sky: FloatArray,
    ) -> CalibrationState:
        """Return the state after an update by a measurement; ``on_sky`` are its residuals on the sky, rad."""
        return replace(
            state,
            mean=mean,
            covariance_by_source=parts,
            observability=self.observability.update(state.observability, measurement.jacobian, measurement.noise),
            consecutive_rejections=0,
            sighting_count=state.sighting_count + 1,
            point_count=state.point_count + len(on_sky) // 2,
            residual_square_sum=state.residual_square_sum + float(on_sky @ on_sky),
        )

    def _comparison(self, state: CalibrationState, prediction: Prediction, residual: FloatArray) -> Comparison:
        """Return the comparison of a sighting from its prediction; ``residual`` is in metres, shape (2 N,)."""
        index: Callable[[str], int] = self.model.sources.index
        noise = {index(source): part for source, part in prediction.noise_by_source.items()}
        measurement = LinearMeasurement(residual, prediction.jacobian, noise)
        innovation = subfilter_innovations(
            state.mean[None], state.covariance[None], measurement, state.mean, prediction.by_attitude_n
        )
        (nis,), (whitened_innovation,) = innovation.nis.tolist(), innovation.whitened_innovation
        return Comparison(
            prediction,
            measurement,
            innovation.covariance[0],
            nis,
            nis - float(whitened_innovation @ whitened_innovation),
            innovation.gain[0],
        )


def _parts_for_covariance(parts: FloatArray, covariance: FloatArray) -> FloatArray:
    """Transform a covariance by source linearly so that its sum is a given covariance."""
    before = parts.sum(axis=0)
    sigma = np.sqrt(np.maximum(np.diagonal(before), np.diagonal(covariance)))
    # States in radians and metres are scaled to unit variance. A state with zero variance keeps zero variance.
    scale = np.outer(sigma, sigma)
    unit = 1.0 / np.where(scale > 0.0, scale, np.inf)
    transformation = _symmetric_root(covariance * unit) @ np.linalg.pinv(
        _symmetric_root(before * unit), rcond=1e-9, hermitian=True
    )
    transformed = transformation @ (parts * unit) @ transformation.T
    missing = covariance * unit - transformed.sum(axis=0)
    reshaped: FloatArray = scale * (transformed + missing / len(parts))
    return reshaped


def _symmetric_root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return root
