"""Sources that can be compared with the truth, by topic: attitudes of the deck, pointings of the theodolite."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from ship_attitude_star.messages.attitude_messages import SMOOTHED_TOPIC
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_estimation.parameters.ship_devices import InsInputConfig
from ship_estimation.parameters.theodolite_devices import AxesConfig
from ship_estimation.rejection_rules import Reason
from ship_geometry.frames import (
    horizon_covariance,
    rotation_from_angles,
    rotation_from_quaternion,
    rotation_vector_covariance,
)
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
from ship_node.messages.field_checks import MessageRejected
from ship_replay.evaluation.statistics import AttitudeErrors, attitude_errors
from ship_replay.offline.outputs import TRUTH_GAP_NS
from ship_stars.camera.config import JOINT, MountingConfig
from ship_watch.orientations import POINTING, SHIP_ATTITUDE, Orientation
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.messages.output_messages import SMOOTHED_POINTING_TOPIC

JOINT_SOLUTION = f"star/{JOINT}/solution"
"""Topic of the deck's attitude from the stars of all sensors."""


class Truth:
    """True attitudes of the deck or of the main optical axis; between two stamps the attitude can be interpolated."""

    def __init__(self, orientation: Orientation) -> None:
        self.orientation = orientation
        self._track = AttitudeTrack(TRUTH_GAP_NS)
        self._rotations: dict[int, FloatArray] = {}
        self._has_rates = True

    def add(self, message: Any) -> None:
        """Add a message of the truth; a message without orientation is ignored."""
        sample = self.orientation.sample(message)
        if sample is None:
            return
        self._has_rates &= sample.rate_d is not None
        self._track.insert(sample)
        self._rotations[sample.time_ns] = sample.rotation_nd

    def __len__(self) -> int:
        return len(self._rotations)

    def rotation_at_stamp(self, stamp_ns: int) -> FloatArray | None:
        """Return the rotation horizon from deck or main frame, shape (3, 3); None if the truth has no such stamp."""
        return self._rotations.get(stamp_ns)

    def rotation_at(self, stamp_ns: int) -> FloatArray | None:
        """Return the rotation horizon from deck or main frame, shape (3, 3).

        Between stamps the rotation is interpolated, and the result is None without rates, in a gap and outside the
        truth.
        """
        exact = self.rotation_at_stamp(stamp_ns)
        return self.interpolated_rotation(stamp_ns) if exact is None and self._has_rates else exact

    def interpolated_rotation(self, stamp_ns: int) -> FloatArray | None:
        """Return the rotation horizon from deck or main frame, shape (3, 3), interpolated; None in a gap or outside."""
        found = self._track.at(stamp_ns)
        return None if found is None else found.rotation_nd


class AttitudeSource(ABC):
    """Attitudes of one source at times at which the truth is known.

    A subclass defines in :meth:`add_message` how a message gives a rotation and its covariance.

    Attributes:
        label: name of the source.
        is_configured: True if the configuration names the source; missing data are then reported.
    """

    def __init__(self, label: str, truth: Truth, is_configured: bool = False) -> None:
        self.label = label
        self.is_configured = is_configured
        self._truth = truth
        self._time_ns: list[int] = []
        self._estimates: list[FloatArray] = []
        self._truths: list[FloatArray] = []
        self._covariances: list[FloatArray] = []

    @abstractmethod
    def add_message(self, message: Any) -> None:
        """Add a message's attitude if the truth is known at its stamp.

        Raises:
            MessageRejected: the message contains an infinite attitude or covariance.
        """

    def errors(self) -> list[AttitudeErrors]:
        """Return the errors in order of stamps; empty if no attitude has a known truth."""
        if not self._time_ns:
            return []
        order = np.argsort(self._time_ns, kind="stable")
        time_ns = np.array(self._time_ns, dtype=np.int64)[order]
        estimates, truths, covariances = (
            np.array(part)[order] for part in (self._estimates, self._truths, self._covariances)
        )
        return [attitude_errors(self.label, self._truth.orientation, time_ns, estimates, truths, covariances)]

    def _add_sample(
        self, time_ns: int, estimate_nd: FloatArray, truth_nd: FloatArray, covariance_n: FloatArray
    ) -> None:
        self._time_ns.append(time_ns)
        self._estimates.append(estimate_nd)
        self._truths.append(truth_nd)
        self._covariances.append(covariance_n)


class PublishedAttitude(AttitudeSource):
    """Attitudes published by the suite, at the stamps of the truth; INVALID attitudes are only counted.

    Attributes:
        has_messages: True if a message was added.
        invalid_count: number of INVALID messages.
    """

    def __init__(self, truth: Truth, label: str = "") -> None:
        super().__init__(label or truth.orientation.label, truth)
        self.invalid_count = 0
        self.has_messages = False

    def add_message(self, message: Any) -> None:
        """Add a ShipAttitude or an OpticalAxisPointing."""
        self.has_messages = True
        if message.status == message.INVALID:
            self.invalid_count += 1
            return
        stamp_ns = ns_from_stamp(message.header.stamp)
        truth_nd = self._truth.rotation_at_stamp(stamp_ns)
        if truth_nd is not None:
            angles = self._truth.orientation.angles_of(message)
            for what, numbers in (
                (", ".join(self._truth.orientation.angles), angles),
                ("rotation_covariance", message.rotation_covariance),
            ):
                if np.any(np.isinf(numbers)):
                    raise MessageRejected(Reason.NON_FINITE, f"{what} is infinite")
            covariance_n = _total_covariance_n(message, angles[0], angles[1])
            self._add_sample(stamp_ns, rotation_from_angles(*angles), truth_nd, covariance_n)


class InsAttitude(AttitudeSource):
    """Attitudes of the deck by ``ins/imu`` alone, at the stamps of the truth; the INS's time offset is not corrected.

    Attributes:
        track: all attitudes of the deck by the INS.
    """

    def __init__(self, truth: Truth, config: InsInputConfig) -> None:
        super().__init__("ins", truth)
        angles = (config.installation_heading_deg, config.installation_pitch_deg, config.installation_roll_deg)
        self._rotation_di = rotation_from_angles(*np.deg2rad(angles))
        self._convention = config.convention
        self.track = AttitudeTrack(round(config.max_gap_s * NS_PER_S))

    def add_message(self, message: Any) -> None:
        """Add a sensor_msgs/Imu; a message without orientation is ignored."""
        stamp_ns = ns_from_stamp(message.header.stamp)
        q = message.orientation
        quaternion = np.array([q.x, q.y, q.z, q.w])
        if not np.linalg.norm(quaternion) > 0.5:
            return
        estimate_nd = rotation_from_quaternion(quaternion, self._convention) @ self._rotation_di.T
        self.track.insert(AttitudeSample(stamp_ns, estimate_nd))
        truth_nd = self._truth.rotation_at_stamp(stamp_ns)
        if truth_nd is not None:
            covariance = message.orientation_covariance.reshape(3, 3)
            unknown = covariance[0, 0] < 0.0 or not covariance.any() or self._convention != "enu_flu"
            covariance_n = np.full((3, 3), np.nan) if unknown else horizon_covariance(covariance)
            self._add_sample(stamp_ns, estimate_nd, truth_nd, covariance_n)


class StarAttitude(AttitudeSource):
    """Attitudes of the deck from one star sensor with its configured installation, or from all sensors.

    Args:
        sensor_id: name of the source.
        truth: true attitude of the deck.
        mounting: installation of the sensor; None if the messages are attitudes of the deck, with installation errors
            in their covariance.
    """

    def __init__(self, sensor_id: str, truth: Truth, mounting: MountingConfig | None) -> None:
        super().__init__(f"star.{sensor_id}", truth, is_configured=mounting is not None)
        self._rotation_dv = np.eye(3)
        self._installation_covariance_v = np.zeros((3, 3))
        if mounting is not None:
            self._rotation_dv = mounting.rotation_ds
            self._installation_covariance_v = np.diag(np.square(mounting.installation_sigma_s))

    def add_message(self, message: Any) -> None:
        """Add a StarHorizonAttitude; a message without attitude (NaN) is ignored."""
        stamp_ns = ns_from_stamp(message.header.stamp)
        truth_nd = self._truth.interpolated_rotation(stamp_ns)
        angles = (message.azimuth, message.elevation, message.roll)
        if truth_nd is None or not np.all(np.isfinite(angles)):
            return
        rotation_nv = rotation_from_angles(*angles)
        installation_n = rotation_nv @ self._installation_covariance_v @ rotation_nv.T
        own_n = _total_covariance_n(message, message.azimuth, message.elevation)
        self._add_sample(stamp_ns, rotation_nv @ self._rotation_dv.T, truth_nd, own_n + installation_n)


class PublishedPointing(PublishedAttitude):
    """Pointings published by the suite, in total and by mode."""

    MODES = ("two_lights", "one_light", "encoder", "stars", "stars_and_lights")

    def __init__(self, truth: Truth, label: str = "") -> None:
        super().__init__(truth, label)
        self._modes: dict[int, int] = {}

    def add_message(self, message: Any) -> None:
        """Add an OpticalAxisPointing."""
        super().add_message(message)
        self._modes[ns_from_stamp(message.header.stamp)] = message.mode

    def errors(self) -> list[AttitudeErrors]:
        """Return the errors of all pointings, then the errors in each mode that occurred."""
        every = super().errors()
        for errors in every[:1]:
            modes = np.array([self._modes[stamp_ns] for stamp_ns in errors.time_ns.tolist()])
            every += [
                errors.select(modes == mode, f"{self.label}.{name}")
                for mode, name in enumerate(self.MODES)
                if np.any(modes == mode)
            ]
        return every


class InsEncoderPointing(AttitudeSource):
    """Pointings by ``theodolite/encoder`` and configured axis errors, transformed to the horizon by the INS alone."""

    def __init__(self, truth: Truth, ins: AttitudeTrack, config: AxesConfig) -> None:
        super().__init__("ins_encoder", truth)
        self._ins = ins
        self._axis_errors = AxisErrors.from_vector(config.values)
        self._readings: dict[int, tuple[float, float]] = {}

    def add_message(self, message: Any) -> None:
        """Add a TheodoliteEncoder."""
        self._readings[ns_from_stamp(message.header.stamp)] = message.azimuth, message.elevation

    def errors(self) -> list[AttitudeErrors]:
        """Return the errors in order of stamps, without covariance; all ``ins/imu`` messages must have been added."""
        for stamp_ns, (azimuth, elevation) in self._readings.items():
            truth_nm, ship = self._truth.rotation_at_stamp(stamp_ns), self._ins.at(stamp_ns)
            if truth_nm is not None and ship is not None and np.isfinite(azimuth) and np.isfinite(elevation):
                rotation_dm = main_axis_rotation(self._axis_errors, azimuth, elevation)
                self._add_sample(stamp_ns, ship.rotation_nd @ rotation_dm, truth_nm, np.full((3, 3), np.nan))
        return super().errors()


def attitude_sources(
    truths: Mapping[str, Truth],
    ship: ShipAttitudeConfig | None,
    star: StarAttitudeConfig | None,
    theodolite: OpticalAxisConfig | None,
) -> dict[str, AttitudeSource]:
    """Return relative topic → the source that collects the topic's attitudes.

    A star sensor gives its horizon attitudes if ``ship_attitude`` uses them, else its solutions.

    Args:
        truths: known truths by topic.
        ship: configuration of ``ship_attitude``; None if not known.
        star: configuration of ``star_attitude``; None if not known.
        theodolite: configuration of ``optical_axis``; None if not known.
    """
    collectors: dict[str, AttitudeSource] = {}
    ins_config = ship.ins if ship else theodolite.ins if theodolite else InsInputConfig()
    deck, axis = truths.get(SHIP_ATTITUDE.truth_topic), truths.get(POINTING.truth_topic)
    if deck is not None:
        ins = InsAttitude(deck, ins_config)
        collectors[SHIP_ATTITUDE.topic] = PublishedAttitude(deck)
        collectors |= {SMOOTHED_TOPIC: PublishedAttitude(deck, "smoothed"), "ins/imu": ins}
        collectors[JOINT_SOLUTION] = StarAttitude(JOINT, deck, None)
        for sensor_id, solved in (star.star_sensors if star else {}).items():
            collectors[f"star/{sensor_id}/solution"] = StarAttitude(sensor_id, deck, solved)
        for sensor_id, sensor in (ship.star_sensors if ship else {}).items():
            collectors.pop(f"star/{sensor_id}/solution", None)
            topic = "horizon_attitude" if sensor.input == "horizon_attitude" else "solution"
            collectors[f"star/{sensor_id}/{topic}"] = StarAttitude(sensor_id, deck, sensor)
    if axis is not None:
        collectors[POINTING.topic] = PublishedPointing(axis)
        collectors[SMOOTHED_POINTING_TOPIC] = PublishedPointing(axis, "smoothed_pointing")
        if deck is not None and theodolite is not None:
            collectors["theodolite/encoder"] = InsEncoderPointing(axis, ins.track, theodolite.axes)
    return collectors


def _total_covariance_n(message: Any, azimuth: float, elevation: float) -> FloatArray:
    """Return the covariance of the rotation vector (North, Up, East), rad².

    If the message does not give this covariance, the covariance is computed from that of the angles.
    """
    rotation_covariance = message.rotation_covariance.reshape(3, 3)
    if rotation_covariance.any():
        return horizon_covariance(rotation_covariance)
    return rotation_vector_covariance(message.covariance.reshape(3, 3), azimuth, elevation)
