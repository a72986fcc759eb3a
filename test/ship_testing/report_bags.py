"""Hand-made short recordings of outputs, for the tests of the report, and the parts of its page."""

import numpy as np

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_estimation.rejection_rules import Reason
from ship_geometry.rotations import ARCSEC
from ship_testing.hand_made_bags import START_NS, innovation, ship_attitude

SECOND_NS = 1_000_000_000
SIGMA_ENU = np.diag([2.0, 3.0, 4.0]) * ARCSEC
"""Standard deviations (diagonal, rad) about East, North and Up of a ship that heads North.

They are pitch 2″, roll 3″, heading 4″; the 95 % limits are 3.9″, 5.9″ and 7.8″.
"""


def write_bag(path, seconds=40, with_truth=True, gap_s=(0, 0), rejected=()):
    """Write attitudes at 10 Hz with 1″ of heading error, and innovations of star.fore at 1 Hz.

    There are no attitudes between the two times of ``gap_s``; the innovations at the seconds ``rejected`` are rejected.
    """
    with BagWriter(path) as bag:
        bag.add_attachment("suite.yaml", "ship_attitude:\n  ros__parameters: {}\n")
        for tick in range(10 * seconds):
            stamp_ns = START_NS + tick * SECOND_NS // 10
            if with_truth:
                bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
            if not gap_s[0] <= tick / 10 < gap_s[1]:
                estimate = ship_attitude(stamp_ns, ARCSEC, covariance_enu=SIGMA_ENU @ SIGMA_ENU)
                # Covariance of (heading, pitch, roll) of a level ship that heads North.
                estimate.covariance = (np.diag([4.0, 2.0, 3.0]) ** 2 * ARCSEC**2).ravel()
                bag.write("ship/attitude", estimate, stamp_ns)
            if tick % 10 == 0:
                accepted = tick // 10 not in rejected
                reason = 0 if accepted else int(Reason.GATE)
                message = innovation(stamp_ns, "star.fore", [ARCSEC, 0.0, 0.0], [ARCSEC] * 3, 1.0, accepted, reason)
                bag.write("ship/innovation", message, stamp_ns)
    return path


def copy_bag(source, writer, prefix=""):
    """Copy a bag's attachments, and its messages with a prefix of the topics, to an open writer; close the writer."""
    with read_bag(source) as bag:
        for name, data in bag.attachments.items():
            writer.add_attachment(name, data)
        for number, record in enumerate(bag.records()):
            writer.write_raw(prefix + record.topic, record.type_name, record.data, record.log_time_ns)
            if number % 100 == 0:
                writer.flush()
    writer.close()


def section(text, name):
    """Return the part of a page from one heading to the next."""
    return text[text.index(f'<h2 id="{name}"'):].partition("</h2>")[2].partition("<h2 ")[0]
