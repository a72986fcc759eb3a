"""The pointing at an encoder reading: by the filter's state and the ship's attitude, with its covariance by source."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray
from ship_geometry.sample_track import SECOND_NS
from theodolite_calib.chain.axis_chain import CHAIN_BLOCKS, ChainErrors, axis_chain, telescope_from_main
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.model import (
    SOURCE_DEFORMATION,
    SOURCE_ENCODER,
    SOURCE_SAVED,
    SOURCE_SHIP,
    SOURCE_SHIP_NOISE,
    with_step,
)
from theodolite_calib.measured.samples import EncoderSample, Mode, PointingEstimate, Status
from theodolite_calib.measured.tracks import EncoderAt, ShipAt


@dataclass(frozen=True)
class AxisAt:
    """The axes at one moment.

    Attributes:
        rotation_nm: horizon from main frame, shape (3, 3).
        parts_n: error covariance of the main axis by source, rotation vector in n, rad², shape (n_sources, 3, 3).
        rotation_nt: horizon from telescope, shape (3, 3).
    """

    rotation_nm: FloatArray
    parts_n: FloatArray
    rotation_nt: FloatArray


class CorrectedAxis:
    """The main axis corrected by one filter state; made once per state, used at the encoder's rate.

    Only states that turn the main axis enter, so only those rows of the covariance are carried.

    Args:
        filter_: the filter and its model.
        state: its state after the last sighting.
    """

    def __init__(self, filter_: CalibrationFilter, state: CalibrationState) -> None:
        self.state = state
        self._filter, self._model = filter_, filter_.model
        blocks = [name for name in CHAIN_BLOCKS if name in self._model.slices]
        self._rows = np.concatenate([self._model.rows(name) for name in blocks])
        self._mean = state.mean[self._rows]
        self._parts = state.parts[:, self._rows[:, None], self._rows]
        self._errors = filter_.sightings.chain_errors(state.mean)
        self._known_axes = self._errors.axes
        self._known_time_s = self._errors.ship_time_s
        self._parallelism = filter_.sightings.parallelism(state.mean)
        self._source = {name: self._model.sources.index(name) for name in self._model.sources}

    def at(self, time_ns: int, ship: ShipAt, encoder: EncoderAt) -> AxisAt:
        """The axis at a moment at or after the state's, with the ship and the encoders of that moment."""
        since_ns = self.state.time_ns if self.state.time_ns is not None else time_ns
        mean, parts = self._carried(max(time_ns - since_ns, 0) * 1e-9, ship)
        errors = ChainErrors(mean[:3], mean[3:6], self._known_axes, self._known_time_s)
        chain = axis_chain(errors, ship.rotation_nd, ship.rate_d, encoder.azimuth, encoder.elevation)
        by_error = chain.by_error[:, : len(self._rows)]
        parts_n = by_error @ parts @ by_error.T
        parts_n[self._source[SOURCE_ENCODER]] += encoder.noise * (chain.by_encoder @ chain.by_encoder.T)
        parts_n[self._source[SOURCE_SHIP_NOISE]] += ship.noise * np.eye(3)
        rotation_nm = chain.rotation_nm
        return AxisAt(rotation_nm, parts_n, telescope_from_main(self._parallelism, rotation_nm)[0])

    def _carried(self, dt_s: float, ship: ShipAt) -> tuple[FloatArray, FloatArray]:
        """Errors and covariance of the chain after ``dt_s``."""
        decay, noise = (values[self._rows] for values in self._model.transition(dt_s))
        mean = decay * self._mean
        mean[:3] = self._filter.ship_error(self._mean[:3], decay[:3])
        parts = self._parts * (decay[:, None] * decay)
        ship_rows, deformation = slice(0, 3), np.arange(3, 6)
        parts[self._source[SOURCE_SHIP], [0, 1, 2], [0, 1, 2]] += noise[:3]
        parts[self._source[SOURCE_DEFORMATION], deformation, deformation] += noise[3:6]
        if self.state.ship_steady_n is not None:
            steady_n = self.state.ship_steady_n
            parts[self._source[SOURCE_SHIP], ship_rows, ship_rows] += (1.0 - decay[0] ** 2) * steady_n
        step = self._filter.ship_step(self.state, ship.slow_covariance_n)
        if step is not None:
            mean, parts = with_step(mean, parts, ship_rows, self._source[SOURCE_SHIP], step)
        return mean, parts


class PointingSource:
    """Makes pointings by a filter's states.

    Args:
        config: the node's parameters.
        filter_: the filter of that configuration.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        self._filter = filter_
        self._recent_ns = round(config.lights_recent_s * SECOND_NS)
        self._corrected: CorrectedAxis | None = None
        self._saved = filter_.model.sources.index(SOURCE_SAVED)

    def estimate(self, state: CalibrationState, sample: EncoderSample, ship: ShipAt, doubt: str) -> PointingEstimate:
        """The pointing at a reading.

        Args:
            state: after the last exposure applied.
            sample: the reading.
            ship: of its moment.
            doubt: why the encoders are in doubt; empty where they are not.
        """
        if self._corrected is None or self._corrected.state is not state:
            self._corrected = CorrectedAxis(self._filter, state)
        azimuth, elevation = sample.vector.tolist()
        axis = self._corrected.at(sample.time_ns, ship, EncoderAt(azimuth, elevation, sample.sigma**2))
        recent = state.used_ns is not None and sample.time_ns - state.used_ns <= self._recent_ns
        mode = Mode.ENCODER if not recent else Mode.ONE_LIGHT if state.light_count == 1 else Mode.TWO_LIGHTS
        status, text = self._worth(state, mode, ship.status, doubt)
        return PointingEstimate(
            time_ns=sample.time_ns,
            rotation_nm=axis.rotation_nm,
            parts_n=axis.parts_n,
            rotation_nt=axis.rotation_nt if recent else np.full((3, 3), np.nan),
            mode=mode,
            status=status,
            light_count=state.light_count if recent else 0,
            text=text,
        )

    def _worth(self, state: CalibrationState, mode: Mode, ship_status: Status, doubt: str) -> tuple[Status, str]:
        if doubt:
            return Status.DEGRADED, doubt
        if state.refusals:
            return Status.DEGRADED, "the last lights disagreed with the encoders and the ship's attitude"
        if ship_status is Status.DEGRADED:
            return Status.DEGRADED, "the ship's attitude is DEGRADED"
        if state.used_ns is None and not np.any(state.parts[self._saved]):
            return Status.DEGRADED, "no light was ever seen and no calibration loaded: axis errors as configured"
        if mode is Mode.ENCODER:
            return Status.COASTING, "no lights: by encoders, axis errors and the ship's attitude"
        return Status.VALID, ""


def no_pointing(filter_: CalibrationFilter, now_ns: int, text: str) -> PointingEstimate:
    """No pointing is claimed."""
    unknown = np.full((3, 3), np.nan)
    parts_n = np.full((len(filter_.model.sources), 3, 3), np.nan)
    return PointingEstimate(now_ns, unknown, parts_n, unknown, Mode.ENCODER, Status.INVALID, 0, text)
