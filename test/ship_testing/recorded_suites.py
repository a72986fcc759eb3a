"""Hand-made bags of a suite: a heading with constant rate, a source with innovations, an active alert."""

from pathlib import Path

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import NS_PER_S, make_header
from ship_geometry.rotations import ARCSEC
from ship_testing.hand_made_bags import FACTORY, START_NS, innovation, ship_attitude

PERIOD_NS = 50_000_000
TURN_RAD_PER_S = 1e-4
ALERT_S = 30


def write_suite(path: Path, length_s: int = 900, prefix: str = "", *, truth: bool = False) -> Path:
    """Write ``ship/attitude`` at 20 Hz, innovations of one star sensor at 1 Hz, and an alert 30 s after the start.

    The heading is ``TURN_RAD_PER_S`` times the seconds since the start. In the last five minutes the star sensor is
    rejected.
    """
    covariance = [[(ARCSEC if row == column else 0.0) ** 2 for column in range(3)] for row in range(3)]
    with BagWriter(path) as bag:
        for number in range(length_s * NS_PER_S // PERIOD_NS):
            stamp_ns = START_NS + number * PERIOD_NS
            since_s = number * PERIOD_NS / NS_PER_S
            heading = TURN_RAD_PER_S * since_s
            attitude = ship_attitude(stamp_ns, heading, covariance_enu=covariance)
            bag.write(f"{prefix}ship/attitude", attitude, stamp_ns)
            if number % 20 == 0:
                is_rejected = since_s >= length_s - 300
                message = innovation(
                    stamp_ns, "star.bow", [ARCSEC] * 3, [ARCSEC] * 3, 3.0, not is_rejected, 19 if is_rejected else 0
                )
                bag.write(f"{prefix}ship/innovation", message, stamp_ns)
                if truth:
                    bag.write(f"{prefix}truth/attitude", ship_attitude(stamp_ns, heading), stamp_ns)
            if since_s == ALERT_S:
                bag.write(f"{prefix}ship/alerts", alert_array(stamp_ns), stamp_ns)
    return path


def alert_array(stamp_ns: int) -> object:
    """Return an alert array with one alert: the star sensor ``star.bow`` is out."""
    stamp = make_header(FACTORY, stamp_ns).stamp
    alert = FACTORY.make(
        "ship_msgs/msg/Alert",
        id="star.bow.out",
        instance=1,
        priority=1,
        state=1,
        source="star.bow",
        text="star.bow out",
        value=8.0,
        limit=5.0,
        unit="sigma",
        raised=stamp,
        changed=stamp,
    )
    return FACTORY.make("ship_msgs/msg/AlertArray", header=make_header(FACTORY, stamp_ns, ""), alerts=[alert])
