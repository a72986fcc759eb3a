"""Which azimuths to bolt the sensors at: the first stays, the others are turned until the total error is least.

On a level ship only the differences in azimuth count, so that keeping the first loses nothing.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.layout.joint_error import Layout, total_arcsec
from ship_geometry.rotations import FloatArray, wrap_pi

_STEP_DEG = 1.0
# Totals closer than this share are the same: the azimuth nearest to the given one is then taken.
_SAME = 1e-9
# Another arrangement of the sensors must gain more than this share over the one near the given azimuths.
_NEARLY_SAME = 0.02
_ALLOWED_LOSS = 0.1
_MOST_ROUNDS = 20


@dataclass(frozen=True)
class AzimuthScan:
    """The joint error while one sensor is turned in azimuth and the others stay.

    Attributes:
        sensor: the one that is turned.
        azimuths_deg: in [0, 360), shape (n,).
        sigmas_arcsec: heading, pitch, roll, shape (n, 3).
        good_deg: azimuths (from, to), clockwise, around the sensor's own that cost at most a tenth over the best;
            None where its own already costs more.
    """

    sensor: str
    azimuths_deg: FloatArray
    sigmas_arcsec: FloatArray
    good_deg: tuple[float, float] | None


def recommended(layout: Layout) -> Layout:
    """The layout with the azimuths of all sensors but the first at the least total error."""
    count = len(layout.names)
    first = layout.angles[0, 0]
    starts = [layout.angles[:, 0]]
    starts += [first + np.arange(count) * circle / count for circle in (np.pi, 2.0 * np.pi)]
    layouts = [_with_azimuths(layout, azimuths) for azimuths in starts]
    # On a heeled ship a start may look into the sea; the given azimuths do not.
    candidates = [_descended(start) for start in layouts if np.isfinite(start.sigmas_arcsec()).all()]
    # The first of nearly equals: from the given azimuths, with the least to rebuild.
    totals = np.array([total_arcsec(candidate.sigmas_arcsec()) for candidate in candidates])
    return candidates[int(np.argmax(totals <= totals.min() * (1.0 + _NEARLY_SAME)))]


def scan(layout: Layout, number: int) -> AzimuthScan:
    """The error over all azimuths of one sensor."""
    azimuths_deg = np.arange(0.0, 360.0, _STEP_DEG)
    angles = np.tile(layout.angles, (azimuths_deg.size, 1, 1))
    angles[:, number, 0] = np.deg2rad(azimuths_deg)
    sigmas = layout.sigmas_arcsec(angles)
    good = total_arcsec(sigmas) <= np.nanmin(total_arcsec(sigmas)) * (1.0 + _ALLOWED_LOSS)
    own = round(np.rad2deg(layout.angles[number, 0]) / _STEP_DEG) % azimuths_deg.size
    return AzimuthScan(layout.names[number], azimuths_deg, sigmas, _run_around(good, own, azimuths_deg))


def _descended(layout: Layout) -> Layout:
    """Each sensor but the first turned to its best azimuth in its turn, until none moves."""
    for _ in range(_MOST_ROUNDS):
        before = layout.angles[:, 0].copy()
        for number in range(1, len(layout.names)):
            scanned = scan(layout, number)
            totals = total_arcsec(scanned.sigmas_arcsec)
            best = scanned.azimuths_deg[totals <= np.nanmin(totals) * (1.0 + _SAME)]
            away = np.abs(wrap_pi(np.deg2rad(best) - layout.angles[number, 0]))
            azimuths = layout.angles[:, 0].copy()
            azimuths[number] = np.deg2rad(best[int(np.argmin(away))])
            layout = _with_azimuths(layout, azimuths)
        if np.array_equal(before, layout.angles[:, 0]):
            break
    return layout


def _with_azimuths(layout: Layout, azimuths: FloatArray) -> Layout:
    angles = layout.angles.copy()
    angles[:, 0] = azimuths
    return replace(layout, angles=angles)


def _run_around(good: NDArray[np.bool_], own: int, azimuths_deg: FloatArray) -> tuple[float, float] | None:
    """First and last azimuth of the unbroken run of good ones around index ``own``, over the bow if need be."""
    if not good[own]:
        return None
    if good.all():
        return 0.0, 360.0
    size = good.size
    backward = next(step for step in range(1, size) if not good[(own - step) % size])
    forward = next(step for step in range(1, size) if not good[(own + step) % size])
    return float(azimuths_deg[(own - backward + 1) % size]), float(azimuths_deg[(own + forward - 1) % size])
