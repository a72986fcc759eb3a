"""From the filter's state and the newest data to the published pointing and its covariance by source."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray
from theodolite_calib.chain.axis_chain import CHAIN_BLOCKS, ChainErrors, axis_chain, telescope_from_main
from theodolite_calib.filter.filter import CalibrationFilter, FilterState
from theodolite_calib.filter.model import SOURCE_DEFORMATION, SOURCE_ENCODER, SOURCE_SHIP, SOURCE_SHIP_NOISE
from theodolite_calib.filter.ship_error import with_step
from theodolite_calib.measured.sighting import EncoderAt, ShipAt


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

    def __init__(self, filter_: CalibrationFilter, state: FilterState) -> None:
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
