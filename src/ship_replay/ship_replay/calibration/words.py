"""A calibration in the words of a shipwright."""

import numpy as np

from ship_geometry.rotations import ARCSEC
from ship_replay.calibration.observability import Combination
from ship_replay.calibration.result import Calibration

_TOGETHER = {
    "bow": "turned together in roll (about the deck's bow axis)",
    "up": "turned together in azimuth (about the deck's up axis)",
    "starboard": "turned together in pitch (about the deck's starboard axis)",
}
_SENSOR_AXES = "boresight", "up axis", "right axis"
_TAKES_PART = 0.3
"""Of a turn, as a share of the largest."""

_TILT_REMEDY = "turn the ship by 180 deg or more, or give a reference of known installation"
_AZIMUTH_REMEDY = (
    "give a reference of known heading, or stay longer in a swell that heels the ship by degrees; turning the ship in "
    "calm water does not help: the INS's heading error turns with it"
)
_APART_REMEDY = "a longer session, or more stars"


def combination_words(combination: Combination, sensors: tuple[str, ...]) -> str:
    """What is turned, and how."""
    if combination.axis is not None:
        who = sensors[0] if len(sensors) == 1 else "all sensors"
        return f"{who} {_TOGETHER[combination.axis]}"
    run_arcsec = combination.run_s / ARCSEC
    parts = []
    for number in np.argsort(-np.abs(run_arcsec.ravel())).tolist():
        sensor, axis = divmod(number, 3)
        value = run_arcsec[sensor, axis]
        if abs(value) > _TAKES_PART * np.max(np.abs(run_arcsec)):
            parts.append(f"{sensors[sensor]} about its {_SENSOR_AXES[axis]} {value:+.2f}″")
    return f"turned against each other: {', '.join(parts)}"


def remedy(combination: Combination) -> str:
    """What would have told it."""
    if combination.axis is None:
        return _APART_REMEDY
    return _AZIMUTH_REMEDY if combination.axis == "up" else _TILT_REMEDY


def limit_words(calibration: Calibration, combination: Combination) -> str:
    """The source of error that most of what is left comes from."""
    largest = int(np.argmax(combination.shares))
    return f"{calibration.sources[largest].replace('_', ' ')} {combination.shares[largest]:.0%}"


def statements(calibration: Calibration) -> list[str]:
    """One line for each combination that the session did not observe well; one in all where there is none."""
    lines = []
    for label, combination in calibration.combinations.items():
        if combination.observed != "yes":
            how = "not observed" if combination.observed == "no" else "partly observed"
            lines.append(
                f"({label}) {how}, {combination.sigma / ARCSEC:.2f}″ of {combination.sigma_before / ARCSEC:.2f}″: "
                f"{combination_words(combination, calibration.sensors)}; {remedy(combination)}"
            )
    return lines or ["every combination of the installation angles was observed"]
