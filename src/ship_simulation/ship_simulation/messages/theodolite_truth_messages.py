"""Messages of the truth about the theodolite, which an estimator never sees."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import angles_from_rotation
from ship_simulation.messages.theodolite_messages import MOUNT_FRAME
from ship_simulation.ship.truth_grid import once_a_second
from ship_simulation.theodolite.run import TheodoliteRun
from theodolite_calib.chain.axes import NAMES

MAIN_FRAME = "theodolite_main"

_TWO_LIGHTS, _ONE_LIGHT, _ENCODER = 0, 1, 2
_EXACT = np.zeros(9)

CALIBRATION_NAMES = (
    *NAMES,
    "focal_length",
    "telescope_azimuth",
    "telescope_elevation",
    "telescope_rotation",
    "deformation_bow",
    "deformation_up",
    "deformation_starboard",
)
"""What truth/calibration holds; telescope_...: angles of the main axis in the telescope."""


def true_pointings(run: TheodoliteRun, factory: MessageFactory) -> Iterator[tuple[int, Any]]:
    """(stamp, OpticalAxisPointing) at the stamps of the truth; mode by the lights in the telescope's view."""
    truth = run.truth
    main = angles_from_rotation(truth.mount.rotation_nm).tolist()
    telescope = angles_from_rotation(truth.rotation_nt).tolist()
    for row, time_ns in enumerate(run.encoder.time_ns[truth.encoder_index].tolist()):
        count = int(truth.light_count[row])
        yield (
            time_ns,
            factory.make(
                "ship_msgs/msg/OpticalAxisPointing",
                header=make_header(factory, time_ns, MAIN_FRAME),
                **dict(zip(("azimuth", "elevation", "image_rotation"), main[row], strict=True)),
                covariance=_EXACT,
                rotation_covariance=_EXACT,
                telescope_azimuth=telescope[row][0],
                telescope_elevation=telescope[row][1],
                telescope_rotation=telescope[row][2],
                mode=_TWO_LIGHTS if count >= 2 else _ONE_LIGHT if count else _ENCODER,
                status=0,
                light_count=count,
            ),
        )


def true_calibrations(run: TheodoliteRun, start_ns: int, factory: MessageFactory) -> Iterator[tuple[int, Any]]:
    """(stamp, TheodoliteCalibration) once a second at stamps of the truth, and at the last."""
    truth, time_ns = run.truth, run.encoder.time_ns[run.truth.encoder_index]
    constants = truth.scene.theodolite
    constant = [*constants.axis_errors.vector(), constants.focal_length_m, *constants.parallelism]
    for row in once_a_second(time_ns, start_ns).tolist():
        stamp_ns = int(time_ns[row])
        yield (
            stamp_ns,
            factory.make(
                "ship_msgs/msg/TheodoliteCalibration",
                header=make_header(factory, stamp_ns, MOUNT_FRAME),
                names=list(CALIBRATION_NAMES),
                values=np.array([*constant, *truth.mount.deformation_d[row]]),
                covariance=np.zeros(len(CALIBRATION_NAMES) ** 2),
                units=["m" if name == "focal_length" else "rad" for name in CALIBRATION_NAMES],
                unobservable=[],
                sighting_count=0,
                residual_rms=float("nan"),
            ),
        )
