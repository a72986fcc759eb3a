"""What of a bag can be compared with the truth: topic by topic, as far as truth and configuration tell."""

from collections.abc import Mapping

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.stars.config import JOINT
from ship_estimation.ins_config import InsInputConfig
from ship_replay.evaluation.attitude_sources import AttitudeSource, InsAttitude, PublishedAttitude, StarAttitude, Truth
from ship_replay.evaluation.pointing_sources import EncoderAlone, Pointing
from ship_replay.offline.orientations import POINTING, SHIP_ATTITUDE
from theodolite_calib.config import OpticalAxisConfig

JOINT_SOLUTION = f"star/{JOINT}/solution"
"""Attitude of the deck by the stars of all sensors."""


def sources(
    truths: Mapping[str, Truth],
    ship: ShipAttitudeConfig | None,
    star: StarAttitudeConfig | None,
    theodolite: OpticalAxisConfig | None,
) -> dict[str, AttitudeSource]:
    """Relative topic → what collects its attitudes.

    A star sensor is one source: by its horizon attitudes where those feed ``ship_attitude``, else by its solutions.

    Args:
        truths: by topic of the truth, those that are known.
        ship: configuration of ``ship_attitude``; None where it is not known.
        star: the same of ``star_attitude``.
        theodolite: the same of ``optical_axis``.
    """
    collectors: dict[str, AttitudeSource] = {}
    ins_config = ship.ins if ship else theodolite.ins if theodolite else InsInputConfig()
    deck, axis = truths.get(SHIP_ATTITUDE.truth_topic), truths.get(POINTING.truth_topic)
    if deck is not None:
        ins = InsAttitude(deck, ins_config)
        collectors |= {SHIP_ATTITUDE.topic: PublishedAttitude(deck), "ins/imu": ins}
        collectors[JOINT_SOLUTION] = StarAttitude(JOINT, deck, None)
        for sensor_id, solved in (star.star_sensors if star else {}).items():
            collectors[f"star/{sensor_id}/solution"] = StarAttitude(sensor_id, deck, solved)
        for sensor_id, sensor in (ship.star_sensors if ship else {}).items():
            collectors.pop(f"star/{sensor_id}/solution", None)
            topic = "horizon_attitude" if sensor.input == "horizon_attitude" else "solution"
            collectors[f"star/{sensor_id}/{topic}"] = StarAttitude(sensor_id, deck, sensor)
    if axis is not None:
        collectors[POINTING.topic] = Pointing(axis)
        if deck is not None and theodolite is not None:
            collectors["theodolite/encoder"] = EncoderAlone(axis, ins.track, theodolite.axes)
    return collectors
