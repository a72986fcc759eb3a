"""Orientations that are read from messages in rows equal the orientations that are read from each message alone."""

from typing import Any

import numpy as np
import pytest

from ship_bags.message_store import RosbagsFactory
from ship_testing.message_rows import rows
from ship_watch.orientations import POINTING, SHIP_ATTITUDE, Orientation

START_NS, COUNT = 1_400_000_000_000_000_000, 20
FACTORY = RosbagsFactory()
NINE = np.zeros(9)


def message(of: Orientation, number: int) -> Any:
    """Return message ``number``; some have a second angle or a rate that is not finite."""
    rng = np.random.default_rng(number)
    angles = dict(zip(of.angles, rng.uniform([0.0, -1.5, -3.0], [6.28, 1.5, 3.0]).tolist(), strict=True))
    if number % 5 == 0:
        angles[of.angles[1]] = [float("nan"), float("inf")][number % 2]
    rate = dict(zip("xyz", rng.standard_normal(3).tolist(), strict=True))
    if number % 3 == 0:
        rate["y"] = float("nan")
    header = {"stamp": START_NS + 10_000_007 * number, "frame_id": "deck"}
    common = {"header": header, **angles, "covariance": NINE, "rotation_covariance": NINE, "status": 0}
    if of is SHIP_ATTITUDE:
        orientation = {**dict.fromkeys("xyz", 0.0), "w": 1.0}
        own = {"orientation": orientation, "angular_velocity": rate, "horizon": 0, "sources": [], "star_age_s": 0.0}
        return FACTORY.make("ship_msgs/msg/ShipAttitude", **common, **own)
    own = {**{f"telescope_{name}": 0.0 for name in ("azimuth", "elevation", "rotation")}, "mode": 0, "light_count": 0}
    return FACTORY.make("ship_msgs/msg/OpticalAxisPointing", **common, **own)


@pytest.mark.parametrize("of", [SHIP_ATTITUDE, POINTING], ids=lambda of: of.label)
def test_samples_of_rows_equal_those_of_messages(of: Orientation) -> None:
    block = rows(message(of, 0).__msgtype__, [message(of, number) for number in range(COUNT)])
    found = of.samples(block)
    for number, sample in enumerate(found):
        alone = of.sample(block.message(number))
        assert (sample is None) == (alone is None) == (number % 5 == 0)
        if sample is not None and alone is not None:
            assert (sample.time_ns, sample.content()) == (alone.time_ns, alone.content())
            assert (sample.rate_d is None) == (of is POINTING or number % 3 == 0)
