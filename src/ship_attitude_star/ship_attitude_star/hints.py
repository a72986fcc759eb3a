"""What a persistent disagreement in heading usually means, in words for the operator."""

import numpy as np

_TOLERANCE_RAD = np.deg2rad(5.0)


def heading_hint(turn_up_rad: float) -> str:
    """A hint where a device and the INS differ by about 90° or 180° in heading; otherwise empty.

    Args:
        turn_up_rad: rotation of the measured against the predicted attitude about Up, rad.
    """
    size = abs(turn_up_rad)
    for angle_deg, advice in (
        (90, "look at ins.convention and at the azimuth of the sensor's or the INS's installation"),
        (180, "look at the azimuth of the sensor's installation and at ins.installation_heading_deg"),
    ):
        if abs(size - np.deg2rad(angle_deg)) < _TOLERANCE_RAD:
            return f" by about {angle_deg}° in heading: {advice}"
    return ""
