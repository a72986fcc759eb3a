"""Advised positions for the drones of a run, at the latest pointing, at most once in a period.

Only a node that gives advice imports this module, because loading scipy's optimisers takes long.
"""

import numpy as np

from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.escort.accuracy import BeaconAccuracy
from theodolite_calib.escort.advice import EscortAdvice, advise
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.subfilters import BEACON_PREFIX
from theodolite_calib.samples.samples import BaselineSample, PointingEstimate
from theodolite_calib.samples.tracks import MeasuredTracks


class EscortAdvisor:
    """Computes advised positions for the drones of one run.

    Args:
        config: parameters of the node.
        filter_: filter of that configuration.
        tracks: tracks of the measured samples.
    """

    def __init__(self, config: OpticalAxisConfig, filter_: CalibrationFilter, tracks: MeasuredTracks) -> None:
        self._tracks = tracks
        self._advised_ns: int | None = None
        self._names: tuple[str, ...] = ()
        self._advised_n: FloatArray | None = None
        self.reconfigure(config, filter_)

    def reconfigure(self, config: OpticalAxisConfig, filter_: CalibrationFilter) -> None:
        """Apply changed noise."""
        self._config, self._filter = config, filter_

    def advice(self, estimate: PointingEstimate) -> EscortAdvice | None:
        """Return the advised positions of the drones; None within the period, without usable drones, or in a gap.

        Args:
            estimate: latest pointing that is not INVALID.
        """
        time_ns, period_ns = estimate.time_ns, round(self._config.escort.period_s * SECOND_NS)
        if self._advised_ns is not None and time_ns - self._advised_ns < period_ns:
            return None
        names = self._usable_drones(estimate)
        ship, encoder = self._tracks.ship_at(time_ns), self._tracks.encoder_at(time_ns)
        if not names or ship is None or encoder is None:
            return None
        samples = {name: sample for name in names if (sample := self._newest_baseline(name, time_ns)) is not None}
        now_n = {name: sample.vector for name, sample in samples.items()}
        accuracy = BeaconAccuracy(
            self._config,
            self._filter,
            ship,
            encoder,
            estimate.state.mean,
            {name: sample.covariance_n for name, sample in samples.items()},
        )
        if self._advised_n is None or names != self._names:
            self._advised_n = np.array([now_n[name] for name in names]) if len(now_n) == len(names) else None
        advice = advise(self._config.escort, accuracy, names, now_n, self._advised_n)
        self._advised_ns, self._names = time_ns, names
        if np.isfinite(advice.sigma_advised):
            self._advised_n = advice.places_n
        return advice

    def _usable_drones(self, estimate: PointingEstimate) -> tuple[str, ...]:
        """Return the drones whose beacons the filter would use."""
        disabled, excluded = set(self._config.sources_off), estimate.state.fault_state.excluded
        return tuple(
            name
            for name in self._config.beacons
            if BEACON_PREFIX + name not in excluded and not {"lights", f"baseline.{name}", f"drone.{name}"} & disabled
        )

    def _newest_baseline(self, name: str, time_ns: int) -> BaselineSample | None:
        """Return the newest baseline to a drone; None if the baseline is rejected or old."""
        sample = self._tracks.baselines[name].newest
        if sample is None or sample.rejection is not None:
            return None
        recent_ns = round(self._config.lights_recent_s * SECOND_NS)
        return sample if abs(time_ns - sample.time_ns) <= recent_ns else None
