"""``ship_attitude`` with the input of single stars."""

from typing import Any

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_estimation.parameters.schema import build
from ship_testing.adapter_runs import (
    FACTORY,
)
from ship_testing.small_voyage import Run, run_adapter
from ship_testing.star_voyage import (
    CAMERA_PARAMETERS,
)

_STAR = {"elevation_deg": 45.0, "camera": CAMERA_PARAMETERS, "input": "observations"}

SENSORS: dict[str, Any] = {
    "fore": {**_STAR, "azimuth_deg": 0.0, "frame_id": "star_fore"},
    "starboard": {**_STAR, "azimuth_deg": 90.0, "frame_id": "star_starboard"},
}

def config(**changes: Any) -> ShipAttitudeConfig:
    values: dict[str, Any] = {"ins": {"frame_id": "ins"}, "star_sensors": SENSORS, **changes}
    return build(ShipAttitudeConfig, values)

def run_new_adapter(arrivals, **changes: Any) -> Run:
    return run_adapter(ShipAttitudeAdapter(config(**changes), FACTORY), arrivals)
