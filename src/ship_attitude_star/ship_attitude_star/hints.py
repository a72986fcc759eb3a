"""What a persistent disagreement in heading usually means, in words for the operator."""

import numpy as np

from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import FloatArray, wrap_pi

_TOLERANCE_RAD = np.deg2rad(5.0)
_QUARTER_TURN = 0.5 * np.pi


def heading_hint(ins_nd: FloatArray, measured_nd: FloatArray) -> str:
    """A hint where the headings differ as they do by the common mistakes of marine drivers; otherwise empty.

    Args:
        ins_nd: attitude of the deck by the INS, shape (3, 3).
        measured_nd: the same by the other source, shape (3, 3).
    """
    by_ins, measured = angles_from_rotation(ins_nd)[0], angles_from_rotation(measured_nd)[0]
    if _near(by_ins + measured, _QUARTER_TURN):
        return ", as if heading were given as yaw (90° - heading): look at ins.convention and at the driver of the INS"
    difference = abs(float(wrap_pi(measured - by_ins)))
    if _near(difference, _QUARTER_TURN):
        return (
            " by about 90° in heading: look at ins.convention and at the azimuth of the sensor's or the INS's "
            "installation"
        )
    if _near(difference, np.pi):
        return (
            " by about 180° in heading: look at the azimuth of the sensor's installation and at "
            "ins.installation_heading_deg"
        )
    return ""


def _near(angle: float, target: float) -> bool:
    return abs(float(wrap_pi(angle - target))) < _TOLERANCE_RAD
