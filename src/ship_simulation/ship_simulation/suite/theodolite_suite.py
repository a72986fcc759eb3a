"""The configuration of ``optical_axis`` that fits a scenario: the two have the same names, group by group."""

from typing import Any

from ship_estimation.ins_config import InsErrorConfig
from ship_simulation.messages.device_messages import INS_FRAME
from ship_simulation.messages.ship_attitude_messages import DECK_FRAME
from ship_simulation.messages.theodolite_messages import (
    ANTENNA_FRAME,
    MOUNT_FRAME,
    SHIP_ANTENNA_ID,
    TELESCOPE_FRAME,
    TELESCOPE_ID,
    beacon_frame,
)
from ship_simulation.scenario.scenario import Scenario
from ship_simulation.suite.shared_parameters import shared, shared_with_groups
from theodolite_calib.config.beacon import BeaconConfig
from theodolite_calib.config.optical_axis import OpticalAxisConfig, ShipConfig


def optical_axis_configuration(scenario: Scenario) -> dict[str, Any]:
    """Parameters of ``optical_axis`` as nested mapping."""
    configuration = shared_with_groups(scenario.theodolite, OpticalAxisConfig)
    configuration["ship"] = _ship(scenario)
    configuration["ins"] = {"frame_id": INS_FRAME, **shared(scenario.ins, InsErrorConfig)}
    configuration["encoder"]["frame_id"] = MOUNT_FRAME
    configuration["telescope"] |= {"telescope_id": TELESCOPE_ID, "frame_id": TELESCOPE_FRAME}
    for key, beacon in scenario.beacons.items():
        known = shared_with_groups(beacon, BeaconConfig)
        known["rtk"] |= {"frame_id": ANTENNA_FRAME, "base_id": SHIP_ANTENNA_ID, "rover_id": key}
        known["imu"] |= {"frame_id": beacon_frame(key)}
        configuration.setdefault("beacons", {})[key] = known
    return configuration


def _ship(scenario: Scenario) -> dict[str, Any]:
    """Where the ship's attitude comes from: simulated, from the filter, or, without stars, from the INS alone."""
    if scenario.fused_attitude.written:
        fused = scenario.fused_attitude
        return {"frame_id": DECK_FRAME, "slow_time_s": fused.time_s, **shared(fused, ShipConfig)}
    return {"source": "ship/attitude" if scenario.star_sensors else "ins/imu"}
