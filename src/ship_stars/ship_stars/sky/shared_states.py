"""Filter states of the errors that all star directions share, with the names of their error sources."""

from collections.abc import Mapping

from ship_estimation.kalman.kalman_filter import StateBlock, block
from ship_stars.sky.config import SkyConfig
from ship_stars.sky.sky_model import UTC

SOURCE_REFRACTION = "refraction"
SOURCE_EARTH_ROTATION = "earth_rotation"
SOURCE_POSITION = "ship_position"
SOURCE_UTC = UTC


def sky_blocks(sky: SkyConfig) -> list[StateBlock]:
    """Return the state blocks, in the order of :data:`ship_stars.sky.sky_model.SHARED_TERMS`.

    The states are in units of sigma, because the sigmas differ between exposures. The error of UT1 is constant for
    days, and so is the error of an unsynchronised clock.
    """
    blocks = [
        block("sky.refraction", [1.0], SOURCE_REFRACTION, time_s=sky.refraction_time_s),
        block("sky.earth_rotation", [1.0], SOURCE_EARTH_ROTATION),
        block("sky.position", [1.0, 1.0], SOURCE_POSITION, time_s=sky.position_time_s),
    ]
    if sky.utc_sigma_s > 0.0:
        blocks.append(block("sky.utc", [1.0], SOURCE_UTC))
    return blocks


def sky_slice(slices: Mapping[str, slice]) -> slice:
    """Return the slice of the states of :func:`sky_blocks` in a filter; empty without such states.

    Args:
        slices: slice of the filter's states for each block.
    """
    if "sky.refraction" not in slices:
        return slice(0, 0)
    return slice(slices["sky.refraction"].start, slices.get("sky.utc", slices["sky.position"]).stop)
