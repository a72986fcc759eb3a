"""What a layout study says in plain words. Every number in them is computed from the layout at hand."""

from html import escape

import numpy as np

from ship_attitude_star.layout.azimuths import AzimuthScan
from ship_attitude_star.layout.joint_error import total_arcsec
from ship_attitude_star.layout.study import LayoutStudy
from ship_geometry.rotations import FloatArray

# A gain below this share leaves the choice to the other needs of the ship.
_WORTH_MOVING = 0.1


def result(study: LayoutStudy) -> str:
    """What the layout as given achieves."""
    count = len(study.layout.names)
    if count == 1:
        return f"The one sensor, “{study.layout.names[0]}”, gives {_errors(study.joint_arcsec)} (1σ)."
    totals = total_arcsec(study.alone_arcsec)
    # Of equals the first, whatever the last bits say.
    best = int(np.argmin(np.round(totals, 6)))
    joint = float(total_arcsec(study.joint_arcsec))
    return (
        f"The {count} sensors together give {_errors(study.joint_arcsec)} (1σ). The best of them alone, "
        f"“{study.layout.names[best]}”, gives {_errors(study.alone_arcsec[best])}: together they are "
        f"{totals[best] / joint:.3g} times better in total."
    )


def advice(study: LayoutStudy) -> str:
    """The recommended azimuths and how much they may be missed, as a list."""
    if len(study.layout.names) == 1:
        return (
            "<p>With one sensor no azimuth is best in total: turning it only moves the error from roll to pitch. Look "
            "along the keel where pitch matters, abeam where roll matters; for both, and for heading, add a second "
            "sensor about a right angle away.</p>"
        )
    given, best = (float(total_arcsec(sigmas)) for sigmas in (study.joint_arcsec, study.best_arcsec))
    first_deg = np.rad2deg(study.best.angles[0, 0]) % 360.0
    items = [f"<li>“{study.best.names[0]}”: {first_deg:g}° from the bow (kept; the others are turned against it)</li>"]
    for number, turned in enumerate(study.scans, start=1):
        best_deg, given_deg = (np.rad2deg(layout.angles[number, 0]) % 360.0 for layout in (study.best, study.layout))
        items.append(
            f"<li>“{escape(turned.sensor)}”: <b>{best_deg:.0f}°</b> from the bow (given: {given_deg:g}°); "
            f"{_tolerance(turned)}</li>"
        )
    return (
        f"<ul>{''.join(items)}</ul><p>Total error there {best:.2f}″, as given {given:.2f}″. {_verdict(given, best)}</p>"
    )


def rule_in_numbers(study: LayoutStudy) -> str:
    """The engineering rule for the first sensor's own elevation and error about the boresight."""
    layout = study.layout
    elevation = layout.angles[0, 1]
    sensor = next(iter(study.config.sensors.values()))
    size = float(np.hypot(sensor.sigma_forward_arcsec, sensor.installation_sigma_forward_arcsec))
    return (
        f"Sensor “{layout.names[0]}” at {np.rad2deg(elevation):g}° elevation, with {size:.3g}″ about its boresight "
        f"(noise and installation together): {size * np.sin(elevation):.3g}″ of heading, and "
        f"{size * np.cos(elevation):.3g}″ of roll if it looks along the keel or of pitch if it looks abeam."
    )


def _errors(sigmas_arcsec: FloatArray) -> str:
    heading, pitch, roll = (f"{sigma:.3g}″" for sigma in sigmas_arcsec)
    return f"heading {heading}, pitch {pitch}, roll {roll}"


def _tolerance(turned: AzimuthScan) -> str:
    if turned.good_deg is None:
        return "no room to turn it without losing a tenth"
    low, high = turned.good_deg
    if high - low == 360.0:
        return "any azimuth costs less than a tenth more"
    return f"anything from {low:.0f}° clockwise to {high:.0f}° costs less than a tenth more"


def _verdict(given: float, best: float) -> str:
    gain = 1.0 - best / given
    if gain < 1e-6:
        return "The layout as given is the best one in azimuth."
    if gain < _WORTH_MOVING:
        return f"The gain of {100.0 * gain:.1f} % is small: what else the ship needs may decide."
    return f"Turning the sensors there takes {100.0 * gain:.0f} % off the total error."
