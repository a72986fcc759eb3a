"""Collects, from the messages of a bag, pointings of the theodolite that can be compared with the truth."""

from typing import Any

import numpy as np

from ship_bags.stamps import ns_from_stamp
from ship_geometry.attitude_track import AttitudeTrack
from ship_replay.evaluation.attitude_errors import AttitudeErrors
from ship_replay.evaluation.attitude_sources import AttitudeSource, PublishedAttitude, Truth
from theodolite_calib.chain.axes import AxisErrors, main_axis_rotation
from theodolite_calib.config import AxesConfig


class Pointing(PublishedAttitude):
    """``theodolite/pointing``, all of it and by mode."""

    MODES = ("two_lights", "one_light", "encoder")

    def __init__(self, truth: Truth) -> None:
        super().__init__(truth)
        self._modes: dict[int, int] = {}

    def take(self, message: Any) -> None:
        """An OpticalAxisPointing."""
        super().take(message)
        self._modes[ns_from_stamp(message.header.stamp)] = message.mode

    def errors(self) -> list[AttitudeErrors]:
        """Errors of all, then of each mode that occurred."""
        every = super().errors()
        for errors in every[:1]:
            modes = np.array([self._modes[stamp_ns] for stamp_ns in errors.time_ns.tolist()])
            every += [
                errors.where(modes == mode, f"{self.label}.{name}")
                for mode, name in enumerate(self.MODES)
                if np.any(modes == mode)
            ]
        return every


class EncoderAlone(AttitudeSource):
    """``theodolite/encoder`` with the axis errors as configured, carried to the horizon by the INS alone."""

    def __init__(self, truth: Truth, ins: AttitudeTrack, config: AxesConfig) -> None:
        super().__init__("ins_encoder", truth)
        self._ins = ins
        self._axis_errors = AxisErrors.from_vector(config.values)
        self._readings: dict[int, tuple[float, float]] = {}

    def take(self, message: Any) -> None:
        """A TheodoliteEncoder."""
        self._readings[ns_from_stamp(message.header.stamp)] = message.azimuth, message.elevation

    def errors(self) -> list[AttitudeErrors]:
        """Errors in order of stamps; the whole of ``ins/imu`` must be there. It claims no covariance."""
        for stamp_ns, (azimuth, elevation) in self._readings.items():
            truth_nm, ship = self._truth.exactly_at(stamp_ns), self._ins.at(stamp_ns)
            if truth_nm is not None and ship is not None and np.isfinite(azimuth) and np.isfinite(elevation):
                rotation_dm = main_axis_rotation(self._axis_errors, azimuth, elevation)
                self._keep(stamp_ns, ship.rotation_nd @ rotation_dm, truth_nm, np.full((3, 3), np.nan))
        return super().errors()
