"""The pointing at an encoder reading: by the filter's state and the ship's attitude, with its covariance by source."""

from dataclasses import dataclass, replace

import numpy as np

from ship_estimation.outcome import Status
from ship_estimation.protection import above_limit, disputed
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from theodolite_calib.chain.axes import DEFORMATION, SHIP, ChainErrors, axis_chain
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.alternatives import BEACON
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import (
    SOURCE_DEFORMATION,
    SOURCE_ENCODER,
    SOURCE_SAVED,
    SOURCE_SHIP,
    SOURCE_SHIP_NOISE,
    chain_rows,
)
from theodolite_calib.measured.samples import EncoderSample, Mode, PointingEstimate
from theodolite_calib.measured.tracks import EncoderAt, ShipAt
from theodolite_calib.optical_axis.integrity import QUANTITIES, integrity_of


@dataclass(frozen=True)
class AxisAt:
    """The axes at one moment, or at several.

    Attributes:
        rotation_nm: horizon from main frame, shape (..., 3, 3).
        parts_n: error covariance of the main axis by source, rotation vector in n, rad², shape (..., n_sources, 3, 3).
        rotation_nt: horizon from telescope, shape (..., 3, 3).
        by_error_n: rotation vector of the main axis in n per state that turns it, shape (..., 3, k).
    """

    rotation_nm: FloatArray
    parts_n: FloatArray
    rotation_nt: FloatArray
    by_error_n: FloatArray


class CorrectedAxis:
    """The main axis corrected by one filter state; made once per state, used at the encoder's rate.

    Only the states that turn the main axis enter, so only these are carried on: the columns are those of
    :data:`theodolite_calib.chain.axes.CHAIN_STATES`.

    Args:
        filter_: the filter and its model.
        state: its state after the last sighting.
    """

    def __init__(self, filter_: CalibrationFilter, state: CalibrationState) -> None:
        self.state = state
        model, self._ship_error = filter_.model, filter_.ship_error
        self._transition = model.transition
        self._rows = chain_rows(model)
        self._mean = state.mean[self._rows]
        self._parts = state.parts[:, self._rows[:, None], self._rows]
        self._disputed = disputed((state.alternatives.mean - state.mean)[:, self._rows], state.separation)
        self._known = filter_.sightings.chain_errors(state.mean)
        self._rotation_mt = rotation_from_angles(*filter_.sightings.parallelism(state.mean)).T
        self._ship, self._deformation, self._encoder, self._ship_noise = (
            model.sources.index(source)
            for source in (SOURCE_SHIP, SOURCE_DEFORMATION, SOURCE_ENCODER, SOURCE_SHIP_NOISE)
        )

    def at(self, since_s: float | FloatArray, ship: ShipAt, encoder: EncoderAt) -> AxisAt:
        """The axis at a moment at or after the state's.

        The result depends on the arguments and the state alone. The arguments may be stacks: the leading axes (...) of
        ``since_s`` and of every number and array in ``ship`` and ``encoder`` are the same, but for
        ``ship.slow_covariance_n``, which is one for the whole stack. A stack gives what the single calls give, but for
        rounding (1e-15).

        Args:
            since_s: time from the state to the moment, at least 0, s, shape (...).
            ship: of that moment.
            encoder: of that moment.
        """
        mean, parts = self._carried(since_s, ship)
        errors = ChainErrors(mean[..., SHIP], mean[..., DEFORMATION], self._known.axes, self._known.ship_time_s)
        chain = axis_chain(errors, ship.rotation_nd, ship.rate_d, encoder.azimuth, encoder.elevation)
        by_error = chain.by_error[..., None, :, : len(self._rows)]
        parts_n = by_error @ parts @ np.swapaxes(by_error, -1, -2)
        by_encoder = chain.by_encoder @ np.swapaxes(chain.by_encoder, -1, -2)
        parts_n[..., self._encoder, :, :] += np.asarray(encoder.noise)[..., None, None] * by_encoder
        parts_n[..., self._ship_noise, :, :] += np.asarray(ship.noise)[..., None, None] * np.eye(3)
        return AxisAt(chain.rotation_nm, parts_n, chain.rotation_nm @ self._rotation_mt, by_error[..., 0, :, :])

    def disputed_n(self, axis: AxisAt) -> FloatArray:
        """What the estimates without one source dispute of one axis: covariance in n, rad², shape (3, 3)."""
        disputed_n: FloatArray = axis.by_error_n @ self._disputed @ axis.by_error_n.T
        return disputed_n

    def _carried(self, since_s: float | FloatArray, ship: ShipAt) -> tuple[FloatArray, FloatArray]:
        """Errors of the chain and their covariance by source, shapes (..., k), (..., n_sources, k, k)."""
        whole_decay, whole_noise = self._transition(since_s)
        decay, noise = whole_decay[..., self._rows], whole_noise[..., self._rows]
        mean, parts = decay * self._mean, self._parts * (decay[..., None, :, None] * decay[..., None, None, :])
        mean[..., SHIP] = self._ship_error.later(self._mean[SHIP], decay[..., SHIP])
        for source, columns in ((self._ship, SHIP), (self._deformation, DEFORMATION)):
            diagonal = np.einsum("...ii->...i", parts[..., source, columns, columns])
            diagonal += noise[..., columns]
        steady_n, now_n = self.state.ship_steady_n, ship.slow_covariance_n
        return self._ship_error.carried(mean, parts, SHIP, decay[..., SHIP], steady_n, now_n)[:2]


class PointingOutput:
    """Makes the pointings by a filter's states: what is claimed at a reading depends on its arguments alone.

    Args:
        config: the node's parameters.
        filter_: the filter of that configuration.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        self._config, self._filter = config, filter_
        self._recent_ns = round(config.lights_recent_s * SECOND_NS)
        self._corrected: CorrectedAxis | None = None
        self._saved = filter_.model.sources.index(SOURCE_SAVED)
        self._disagreement = filter_.model.sources.index(SOURCE_SHIP)

    def estimate(
        self, sample: EncoderSample, ship: ShipAt, doubt: str, doubt_rad: float, state: CalibrationState
    ) -> PointingEstimate:
        """The pointing at a reading.

        Args:
            sample: the reading.
            ship: of its moment.
            doubt: why the encoders are in doubt; empty where they are not.
            doubt_rad: standard deviation of each angle by that, beside its noise.
            state: after the last exposure applied.
        """
        if self._corrected is None or self._corrected.state is not state:
            self._corrected = CorrectedAxis(self._filter, state)
        recent = state.used_ns is not None and sample.time_ns - state.used_ns <= self._recent_ns
        mode = Mode.ENCODER if not recent else Mode.ONE_LIGHT if state.light_count == 1 else Mode.TWO_LIGHTS
        status, text = self._worth(state, mode, ship.status, doubt)
        azimuth, elevation = sample.vector.tolist()
        since_s = 0.0 if state.time_ns is None else max(sample.time_ns - state.time_ns, 0) * 1e-9
        axis = self._corrected.at(since_s, ship, EncoderAt(azimuth, elevation, sample.sigma**2 + doubt_rad**2))
        if state.trust.conflict is not None:
            axis.parts_n[self._disagreement] += state.trust.conflict.spread_n
        undisputed_n = axis.parts_n.sum(axis=0)
        if recent:  # Of where the axis points without lights the separations say nothing.
            axis.parts_n[self._disagreement] += self._corrected.disputed_n(axis)
        estimate = PointingEstimate(
            time_ns=sample.time_ns,
            rotation_nm=axis.rotation_nm,
            parts_n=axis.parts_n,
            covariance_n=axis.parts_n.sum(axis=0),
            undisputed_n=undisputed_n,
            rotation_nt=axis.rotation_nt if recent else np.full((3, 3), np.nan),
            mode=mode,
            status=status,
            light_count=state.light_count if recent else 0,
            state=state,
            text=text,
            by_error_n=axis.by_error_n,
            rotation_dm=None if ship.chord_nd is None else ship.chord_nd.T @ axis.rotation_nm,
        )
        if status is Status.DEGRADED or not self._config.integrity.alert_limit_arcsec:
            return estimate
        text = above_limit(integrity_of(self._filter, self._config, estimate), QUANTITIES)
        return replace(estimate, status=Status.DEGRADED, text=text) if text else estimate

    def _worth(self, state: CalibrationState, mode: Mode, ship_status: Status, doubt: str) -> tuple[Status, str]:
        if doubt:
            return Status.DEGRADED, doubt
        if state.refusals:
            return Status.DEGRADED, "the last lights disagreed with the encoders and the ship's attitude"
        if state.trust.conflict is not None:
            return Status.DEGRADED, "lights have disagreed with the encoders and the ship's attitude: nobody knows why"
        for source, left_out in state.trust.left_out.items():
            unconfirmed = state.used_ns is None or state.used_ns < left_out.exclusion.since_ns
            if mode is Mode.ENCODER or unconfirmed or not source.startswith(BEACON):
                return Status.DEGRADED, f"{source} is excluded: {left_out.why}"
        if ship_status is Status.DEGRADED:
            return Status.DEGRADED, "the ship's attitude is DEGRADED"
        if state.used_ns is None and not np.any(state.parts[self._saved]):
            return Status.DEGRADED, "no light was ever seen and no calibration loaded: axis errors as configured"
        if mode is Mode.ENCODER:
            return Status.COASTING, "no lights: by encoders, axis errors and the ship's attitude"
        return Status.VALID, ""


def no_pointing(filter_: CalibrationFilter, state: CalibrationState, now_ns: int, text: str) -> PointingEstimate:
    """No pointing is claimed."""
    unknown = np.full((3, 3), np.nan)
    parts_n = np.full((len(filter_.model.sources), 3, 3), np.nan)
    nothing = unknown, parts_n, unknown, unknown, unknown
    return PointingEstimate(now_ns, *nothing, Mode.ENCODER, Status.INVALID, 0, state, text)
