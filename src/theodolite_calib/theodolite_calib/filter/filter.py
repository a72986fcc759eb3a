"""The calibration filter: how a state is carried in time, compared with a sighting and changed by it.

The filter itself remembers nothing. A :class:`CalibrationState` is never changed in place, so that the time-ordered log
can keep each of them and return to it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from ship_attitude_star.stars.exposure import StarExposure
from ship_attitude_star.stars.spatial_errors import PixelStay
from ship_estimation.hypotheses import compare_rows
from ship_estimation.ins import InsJump
from ship_estimation.kalman import LinearMeasurement, predict, update
from ship_geometry.rotations import FloatArray
from theodolite_calib.chain.axes import NAMES
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.alternatives import Alternatives, SourceRows
from theodolite_calib.filter.model import SOURCE_AXES, SOURCE_SHIP, ShipErrorProcess, state_model
from theodolite_calib.filter.observability import Observability, Unaided
from theodolite_calib.filter.prediction import Prediction, SightingModel
from theodolite_calib.filter.star_comparison import StarComparison, StarModel
from theodolite_calib.filter.trust import Trust, no_doubt
from theodolite_calib.measured.encoder_watch import EncoderJump
from theodolite_calib.measured.sighting import Sighting

Jump = EncoderJump | InsJump

_NO_STAYS: MappingProxyType[str, PixelStay] = MappingProxyType({})

_STEPS = 5
# What a step of this size (rad) leaves of the equations that is not linear is its square: below rounding.
_SMALL_STEP = 1e-5


@dataclass(frozen=True)
class CalibrationState:
    """Everything the filter knows after its last sighting.

    Attributes:
        time_ns: moment of the state; None before the first sighting.
        mean: estimated errors, shape (..., n); the leading axis may be one of hypotheses.
        parts: covariance by source, shape (..., n_sources, n, n).
        unaided: the covariance by the sightings alone (:mod:`theodolite_calib.filter.observability`).
        alternatives: the estimates without one source each.
        trust: which sources are excluded, and what disagrees.
        separation: distance of each of the alternatives from the estimate by all sources in the pointing of the last
            sighting used, in its sigmas, shape (h,).
        ship_steady_n: stated covariance that the ship's error follows, rad²; None where none is stated.
        refusals: sightings in a row, of lights or of stars, that disagreed with the encoders and the ship.
        refused_for: reason of the last of them, for people.
        used_ns: moment of the last sighting of lights used; None before it.
        light_count: lights used in it.
        stars_ns: moment of the last exposure of stars used; None before it.
        stays: by camera, how long its stars have kept their pixels, where that matters; none of before the state was
            opened.
        sighting_count: sightings used, of lights and of stars.
        points_used: lights and stars in all of them.
        squares: sum of the squares of their residuals on the sky, rad².
    """

    time_ns: int | None
    mean: FloatArray
    parts: FloatArray
    unaided: Unaided
    alternatives: Alternatives
    trust: Trust
    separation: FloatArray
    ship_steady_n: FloatArray | None = None
    refusals: int = 0
    refused_for: str = ""
    used_ns: int | None = None
    light_count: int = 0
    stars_ns: int | None = None
    stays: MappingProxyType[str, PixelStay] = field(default_factory=lambda: _NO_STAYS)
    sighting_count: int = 0
    points_used: int = 0
    squares: float = 0.0

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the errors, shape (..., n, n)."""
        total: FloatArray = self.parts.sum(axis=-3)
        return total

    @property
    def informed_ns(self) -> int | None:
        """Moment of the last sighting used, of lights or of stars; None before it."""
        return max((time_ns for time_ns in (self.used_ns, self.stars_ns) if time_ns is not None), default=None)

    @property
    def residual_rms(self) -> float:
        """Of the residuals of lights and stars on the sky, rad; NaN before the first."""
        return float(np.sqrt(self.squares / self.points_used)) if self.points_used else float("nan")


@dataclass(frozen=True)
class Comparison:
    """A sighting linearised at the predicted state.

    Attributes:
        prediction: of the sighting.
        measurement: residual in metres with its Jacobian and noise.
        covariance: of the residual, m², shape (2 N, 2 N).
        nis: normalised innovation squared.
        angles_nis: share of it that no attitude of the telescope explains: of the angles between the lights.
        gain: of the optimal update, shape (n, 2 N).
    """

    prediction: Prediction
    measurement: LinearMeasurement
    covariance: FloatArray
    nis: float
    angles_nis: float
    gain: FloatArray


class CalibrationFilter:
    """The model of a configuration and the steps from state to state.

    Args:
        config: the node's parameters.
    """

    def __init__(self, config: OpticalAxisConfig) -> None:
        self.model = state_model(config)
        self.sightings = SightingModel(config, self.model)
        self.stars = StarModel(config, self.model, self.sightings)
        self.observability = Observability(self.model, tells_lens=bool(config.telescopes))
        self.ship_error = ShipErrorProcess(config, self.model)
        self.rows = SourceRows(config, self.model, self.ship_error)

    def initial_state(self) -> CalibrationState:
        """The state before any sighting: nothing is known of the errors beyond the configuration."""
        return self.started(np.zeros(self.model.size), self.model.initial_parts())

    def started(self, mean: FloatArray, parts: FloatArray) -> CalibrationState:
        """The state before any sighting, with errors that are known so far; shapes (n,), (n_sources, n, n)."""
        alternatives = self.rows.start(mean, parts.sum(axis=0))
        apart = np.zeros(len(self.rows.sources))
        return CalibrationState(
            None, mean, parts, self.observability.start(), alternatives, no_doubt(self.rows), apart
        )

    def predicted(self, state: CalibrationState, time_ns: int, ship_now_n: FloatArray | None) -> CalibrationState:
        """The state carried to a later moment.

        Args:
            state: after the sighting before.
            time_ns: the moment.
            ship_now_n: covariance of the ship's error as then stated, rad², shape (3, 3); None where none is.
        """
        dt_s = 0.0 if state.time_ns is None else max(time_ns - state.time_ns, 0) * 1e-9
        decay, noise = self.model.transition(dt_s)
        parts = predict(state.parts, decay, noise, self.model.source_of)
        mean, steady_n, ship = decay * state.mean, state.ship_steady_n, self.ship_error.columns
        mean[..., ship] = self.ship_error.later(state.mean[..., ship], decay[ship])
        mean, parts, step = self.ship_error.carried(mean, parts, ship, decay[ship], steady_n, ship_now_n)
        unaided = self.observability.predicted(state.unaided, dt_s, steady_n)
        if step is not None:
            unaided = self.observability.with_ship_step(unaided, step)
        return replace(
            state,
            time_ns=time_ns if state.time_ns is None else max(time_ns, state.time_ns),
            mean=mean,
            parts=parts,
            unaided=unaided,
            alternatives=self.rows.predicted(state.alternatives, time_ns, ship_now_n),
            ship_steady_n=ship_now_n,
        )

    def opened(self, state: CalibrationState, jump: Jump) -> CalibrationState:
        """The state after a jump: the INS's slow error, or the encoders' zero points, may be off by as much."""
        if isinstance(jump, InsJump):
            state = self.predicted(state, jump.time_ns, None)
            states, source, covariance = self.model.rows("ship.attitude"), SOURCE_SHIP, jump.covariance_n
        else:
            first_axis = self.model.slices["axes"].start
            states, source = first_axis + np.array([NAMES.index("g"), NAMES.index("h")]), SOURCE_AXES
            covariance = np.outer(jump.jump, jump.jump) + jump.sigma_rad**2 * np.eye(2)
        parts = state.parts.copy()
        parts[..., self.model.sources.index(source), states[:, None], states] += covariance
        rows = self.rows.opened(state.alternatives, states, covariance)
        return replace(state, parts=parts, alternatives=rows, stays=_NO_STAYS)

    def without(self, state: CalibrationState, source: str) -> CalibrationState:
        """The state by all sources but one: the estimate that has done without it takes the first place.

        Of the telescope there is none: the state is that before the lights contradicted.
        """
        if source not in self.rows.sources:
            rows = self.rows.restarted(state.alternatives, state.mean, state.covariance)
            return replace(state, alternatives=rows)
        rows, row = state.alternatives, self.rows.sources.index(source)
        mean, covariance = rows.mean[row], rows.parts[row, 0]
        return replace(
            state,
            mean=mean,
            parts=_reshaped(state.parts, covariance),
            alternatives=self.rows.restarted(rows, mean, covariance),
            separation=np.zeros_like(state.separation),
            stays=_NO_STAYS,
        )

    def unknown(self, state: CalibrationState) -> CalibrationState:
        """The predicted state before a sighting: the errors of excluded sources may have changed by any amount."""
        excluded, parts = state.trust.excluded, state.parts
        if excluded:
            parts = self.rows.with_unknown(parts, self.model.sources.index(SOURCE_AXES), excluded)
        return replace(state, parts=parts, alternatives=self.rows.unknown(state.alternatives, excluded))

    def aligned(self, state: CalibrationState, sighting: Sighting) -> CalibrationState:
        """The state with the errors that are unknown (:meth:`unknown`) where a sighting has them.

        They may be degrees away, and the gate is linear. What stood there has no weight.
        """
        comparison = self.compare(state, sighting)
        if comparison is None:
            return state
        after, _ = self.used(state, sighting, comparison)
        states = self.rows.states_of(state.trust.excluded)
        mean, rows = state.mean.copy(), state.alternatives.mean.copy()
        mean[states] = rows[:, states] = after.mean[states]
        return replace(state, mean=mean, alternatives=replace(state.alternatives, mean=rows))

    def compare(self, state: CalibrationState, sighting: Sighting) -> Comparison | None:
        """Compare a sighting with a state predicted to its moment; None where a light would be behind the telescope."""
        prediction = self.sightings.predict(state.mean, sighting)
        if not np.all(np.isfinite(prediction.residual)):
            return None
        return self._compared(state, prediction, prediction.residual)

    def used(
        self, state: CalibrationState, sighting: Sighting, comparison: Comparison
    ) -> tuple[CalibrationState, Comparison]:
        """The state after a sighting, from the state predicted to its moment, and the comparison it rests on.

        The sighting is linearised again at the new estimate until the estimate no longer moves (Gauss–Newton). That
        matters where a first sighting is far from what was known.
        """
        compared, mean = comparison, state.mean
        for _ in range(_STEPS):
            correction, parts = update(state.parts, compared.measurement, compared.gain)
            turned = compared.prediction.turn_n @ (state.mean + correction - mean)
            mean = state.mean + correction
            if np.max(np.abs(turned)) < _SMALL_STEP:
                break
            prediction = self.sightings.predict(mean, sighting)
            compared = self._compared(state, prediction, prediction.residual + prediction.jacobian @ correction)
        unaided = self.observability.updated(state.unaided, compared.measurement.jacobian, compared.measurement.noise)
        on_sky = comparison.measurement.residual / comparison.prediction.camera.focal_length_m
        after = replace(
            state,
            mean=mean,
            parts=parts,
            unaided=unaided,
            refusals=0,
            used_ns=sighting.time_ns,
            light_count=len(sighting.names),
            sighting_count=state.sighting_count + 1,
            points_used=state.points_used + len(sighting.names),
            squares=state.squares + float(on_sky @ on_sky),
        )
        return after, compared

    def used_stars(
        self, state: CalibrationState, exposure: StarExposure, comparison: StarComparison
    ) -> CalibrationState:
        """The state after an exposure of stars, from the state predicted to its moment; the rows are left as they are.

        Args:
            state: predicted.
            exposure: its stars.
            comparison: of them with that state.
        """
        measurement, (gain,) = comparison.measurement, comparison.rows.gain
        stays = state.stays
        if exposure.stay is not None:
            stays = MappingProxyType({**stays, exposure.source: exposure.stay})
        correction, parts = update(state.parts, measurement, gain)
        return replace(
            state,
            mean=state.mean + correction,
            parts=parts,
            unaided=self.observability.updated(state.unaided, measurement.jacobian, measurement.noise),
            refusals=0,
            stars_ns=exposure.time_ns,
            stays=stays,
            sighting_count=state.sighting_count + 1,
            points_used=state.points_used + len(measurement.residual) // 2,
            squares=state.squares + float(measurement.residual @ measurement.residual),
        )

    def _compared(self, state: CalibrationState, prediction: Prediction, residual: FloatArray) -> Comparison:
        """The comparison of a sighting by its prediction; ``residual`` is in metres, shape (2 N,)."""
        index: Callable[[str], int] = self.model.sources.index
        noise = {index(source): part for source, part in prediction.noise_by_source.items()}
        measurement = LinearMeasurement(residual, prediction.jacobian, noise)
        found = compare_rows(
            state.mean[None], state.covariance[None], measurement, state.mean, prediction.by_attitude_n
        )
        (nis,), (turn,) = found.nis.tolist(), found.turn
        return Comparison(prediction, measurement, found.covariance[0], nis, nis - float(turn @ turn), found.gain[0])


def _reshaped(parts: FloatArray, covariance: FloatArray) -> FloatArray:
    """Covariance parts that add up to another covariance, each carried over by the one map that leads there."""
    before = parts.sum(axis=0)
    sigma = np.sqrt(np.maximum(np.diagonal(before), np.diagonal(covariance)))
    # Radians and metres are made alike; a state without a variance keeps none.
    scale = np.outer(sigma, sigma)
    unit = 1.0 / np.where(scale > 0.0, scale, np.inf)
    carry = _root(covariance * unit) @ np.linalg.pinv(_root(before * unit), rcond=1e-9, hermitian=True)
    carried = carry @ (parts * unit) @ carry.T
    missing = covariance * unit - carried.sum(axis=0)
    reshaped: FloatArray = scale * (carried + missing / len(parts))
    return reshaped


def _root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return root
