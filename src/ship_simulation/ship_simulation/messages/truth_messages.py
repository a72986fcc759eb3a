"""Messages of the truth, which an estimator never sees."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import wrap_pi
from ship_simulation.messages.ship_attitude_messages import DECK_FRAME, true_attitude_maker
from ship_simulation.run import SimulatedRun
from ship_simulation.ship.truth_grid import once_a_second


def truth_attitudes(run: SimulatedRun, factory: MessageFactory) -> Iterator[tuple[int, Any]]:
    """(stamp, ShipAttitude) at the stamps of the truth."""
    time_ns = run.ins.time_ns[run.truth.ins_index]
    make = true_attitude_maker(time_ns, run.truth.rotation_nd, run.truth.rate_d, factory)
    for row, stamp_ns in enumerate(time_ns.tolist()):
        yield stamp_ns, make(row, row)


def truth_alignments(run: SimulatedRun, factory: MessageFactory) -> Iterator[tuple[int, Any]]:
    """(stamp, AlignmentState) once a second at stamps of the truth, and at the last."""
    index = run.truth.ins_index
    chosen = index[once_a_second(run.ins.time_ns[index], run.start_ns)]
    constant = _constant_values(run)
    names = ["ins.north", "ins.up", "ins.east", *constant]
    units = ["s" if name.endswith("time_offset") else "rad" for name in names]
    for sample in chosen.tolist():
        time_ns = int(run.ins.time_ns[sample])
        yield (
            time_ns,
            factory.make(
                "ship_msgs/msg/AlignmentState",
                header=make_header(factory, time_ns, DECK_FRAME),
                names=names,
                values=np.array([*run.truth.ins.attitude_error_n[sample], *constant.values()]),
                covariance=np.zeros(len(names) ** 2),
                units=units,
            ),
        )


def _constant_values(run: SimulatedRun) -> dict[str, float]:
    """Name → true value of what does not change during the run."""
    values = {"ins.time_offset": run.truth.ins.time_offset_s}
    for key, device in run.truth.stars.items():
        azimuth, elevation, roll = angles_from_rotation(device.rotation_dv).tolist()
        values |= {f"star.{key}.azimuth": azimuth, f"star.{key}.elevation": elevation, f"star.{key}.roll": roll}
        values[f"star.{key}.time_offset"] = device.time_offset_s
    for key, device in run.truth.references.items():
        heading, pitch, roll = angles_from_rotation(device.rotation_dv).tolist()
        values |= {f"reference.{key}.roll": roll, f"reference.{key}.pitch": pitch}
        values |= {f"reference.{key}.heading": float(wrap_pi(heading))}
        values[f"reference.{key}.time_offset"] = device.time_offset_s
    return values
