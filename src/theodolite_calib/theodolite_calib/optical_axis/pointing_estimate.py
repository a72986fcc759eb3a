"""The pointing at an encoder reading, with what it rests on and what it is worth."""

import numpy as np

from ship_geometry.sample_track import SECOND_NS
from theodolite_calib.config.optical_axis import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, FilterState
from theodolite_calib.filter.model import SOURCE_SAVED
from theodolite_calib.measured.samples import EncoderSample, Mode, PointingEstimate, Status
from theodolite_calib.measured.sighting import EncoderAt, ShipAt
from theodolite_calib.optical_axis.pointing_output import CorrectedAxis


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

    def estimate(
        self, state: FilterState, sample: EncoderSample, ship: ShipAt, ship_status: Status, doubt: str
    ) -> PointingEstimate:
        """The pointing at a reading.

        Args:
            state: after the last exposure applied.
            sample: the reading.
            ship: of its moment.
            ship_status: what the source of the ship's attitude says that it is worth.
            doubt: why the encoders are in doubt; empty where they are not.
        """
        if self._corrected is None or self._corrected.state is not state:
            self._corrected = CorrectedAxis(self._filter, state)
        azimuth, elevation = sample.vector.tolist()
        axis = self._corrected.at(sample.time_ns, ship, EncoderAt(azimuth, elevation, sample.sigma**2))
        recent = state.used_ns is not None and sample.time_ns - state.used_ns <= self._recent_ns
        mode = Mode.ENCODER if not recent else Mode.ONE_LIGHT if state.light_count == 1 else Mode.TWO_LIGHTS
        status, text = self._worth(state, mode, ship_status, doubt)
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

    def _worth(self, state: FilterState, mode: Mode, ship_status: Status, doubt: str) -> tuple[Status, str]:
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
