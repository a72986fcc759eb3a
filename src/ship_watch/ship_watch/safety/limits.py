"""Limits of a ship: accuracy of its angles, age and rate of its inputs, delays of its alerts.

A ship has a YAML file with the limits that differ from the defaults, read by :func:`read_limits`:

    heading_arcsec: 8.0
    every_input: {refusals: 10}
    inputs:
      star_bow: {rate_hz: 2.0}

The alerts, the page, the terminal and the report use the same limits.
"""

import difflib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ship_bags.parameter_yaml import read_nested_parameters
from ship_estimation.parameters.fields import mapping_of, parameter, section
from ship_estimation.parameters.schema import ParameterError, build
from ship_watch.topics import SOURCE_KINDS

_DEVICE_NAME = re.compile(r"(star|reference)_.+")


@dataclass(frozen=True)
class InputLimits:
    """Limits of one source of measurements."""

    rate_hz: float = parameter(
        0.0, doc="minimum rate of arrival; 0 for no limit", unit="Hz", minimum=0.0, maximum=1e4
    )
    age_s: float = parameter(
        0.0,
        doc="maximum time without a message; 0 for three message periods, at least 2 s",
        unit="s", minimum=0.0, maximum=1e6,
    )
    refusals: int = parameter(
        5, doc="rejected measurements in a row after which the source is OUT", minimum=1, maximum=1_000_000
    )
    accepted: int = parameter(
        10, doc="accepted measurements in a row after which the source is IN again", minimum=1, maximum=1_000_000
    )


@dataclass(frozen=True)
class AlertTimes:
    """Delays until an alert is raised, cleared and escalated."""

    raise_after_s: float = parameter(
        0.2, doc="duration of a situation after which its alert is raised", unit="s", minimum=0.0, maximum=60.0
    )
    over_after_s: float = parameter(
        5.0,
        doc="time for which an accuracy must exceed its limit before an alert is raised, unless the alert of a source "
        "explains it: in a seaway an accuracy exceeds its limit briefly",
        unit="s", minimum=0.0, maximum=600.0,
    )
    start_s: float = parameter(
        10.0,
        doc="time from the start after which an output that was never received raises an alert",
        unit="s", minimum=0.0, maximum=600.0
    )
    clear_after_s: float = parameter(
        5.0, doc="time without the situation after which its alert is over", unit="s", minimum=0.0, maximum=600.0
    )
    escalate_after_s: float = parameter(
        60.0,
        doc="time after which an unacknowledged warning is repeated, or becomes an alarm",
        unit="s", minimum=1.0, maximum=300.0,
    )
    silence_s: float = parameter(
        30.0, doc="time for which a silenced alert makes no sound", unit="s", minimum=0.0, maximum=30.0
    )


@dataclass(frozen=True)
class MachineLimits:
    """Limits of the computer on which the suite runs."""

    disk_path: str = parameter("", doc="a folder on the disk for recordings; empty if there is none")
    disk_free_gb: float = parameter(
        10.0, doc="minimum free space of that disk", unit="GB", minimum=0.0, maximum=1e6
    )
    box_lost: int = parameter(
        0, doc="entries that a black box may lose without an alert", minimum=0, maximum=1_000_000_000
    )
    clock_offset_s: float = parameter(
        0.05, doc="maximum time by which stamps may be ahead of the computer's clock", unit="s",
        minimum=0.001, maximum=1e6,
    )
    require_security: bool = parameter(
        False, doc="true: a suite starts only with DDS security, enforced, with the ship's own keystore"
    )
    authority_sha256: str = parameter(
        "",
        doc="SHA-256 of the certificate of the authority that signs the identities of this ship's keystore, in "
        "hexadecimal, as printed by openssl x509 -fingerprint -sha256; empty for any",
    )


@dataclass(frozen=True)
class Limits:
    """All limits of a ship. Limits of angles apply to 1.96 sigma (95 %).

    Set the limits of angles for your task. The defaults are not derived from a task: the example suites and bags are
    within them for 95 % of the time.
    """

    heading_arcsec: float = parameter(
        6.0, doc="limit of the heading, 95 %", unit="arcsec", minimum=0.1, maximum=360_000.0
    )
    tilt_arcsec: float = parameter(
        4.0, doc="limit of pitch and roll, each, 95 %", unit="arcsec", minimum=0.1, maximum=360_000.0
    )
    pointing_arcsec: float = parameter(
        12.0,
        doc="limit of the pointing's azimuth times the cosine of its elevation, and of its elevation, each, 95 %",
        unit="arcsec", minimum=0.1, maximum=360_000.0,
    )
    unsafe_factor: float = parameter(
        3.0, doc="ratio of accuracy to limit above which an angle is UNSAFE", minimum=1.0, maximum=1000.0
    )
    better_after_s: float = parameter(
        5.0,
        doc="hold time before the safety of an angle improves; an accuracy that exceeded its limit must then be below "
        "90 % of the limit for this time, or below the limit for six times this time",
        unit="s", minimum=0.0, maximum=600.0
    )
    attitude_age_s: float = parameter(
        1.0, doc="maximum time without a message of ship/attitude", unit="s", minimum=0.05, maximum=3600.0
    )
    pointing_age_s: float = parameter(
        1.0, doc="maximum time without a message of theodolite/pointing", unit="s", minimum=0.05, maximum=3600.0
    )
    stars_age_s: float = parameter(
        30.0, doc="maximum time without used stars", unit="s", minimum=0.1, maximum=1e6
    )
    lights_age_s: float = parameter(
        30.0, doc="maximum time without used lights", unit="s", minimum=0.1, maximum=1e6
    )
    every_input: InputLimits = section(InputLimits)
    inputs: dict[str, InputLimits] = mapping_of(
        doc="sources with limits of their own in place of every_input, by kind (star) or name (star_bow for star.bow)"
    )
    alerts: AlertTimes = section(AlertTimes)
    machine: MachineLimits = section(MachineLimits)

    def __post_init__(self) -> None:
        for name in self.inputs:
            if name not in SOURCE_KINDS and not _DEVICE_NAME.fullmatch(name):
                near = difflib.get_close_matches(name.partition("_")[0], SOURCE_KINDS, n=1)
                meant = f"; did you mean '{near[0]}'?" if near else ""
                raise ParameterError(
                    f"parameter 'inputs.{name}' is not a source: expected one of {', '.join(SOURCE_KINDS)}, star_ID or "
                    f"reference_ID{meant}",
                    f"inputs.{name}", value=name,
                )

    def angle_limit(self, angle: str) -> float:
        """Return the limit of one of :data:`ship_watch.suite_state.ANGLES`, rad.

        Raises:
            KeyError: there is no such angle.
        """
        tilt, pointing = self.tilt_arcsec, self.pointing_arcsec
        limits_arcsec = {
            "heading": self.heading_arcsec, "pitch": tilt, "roll": tilt, "azimuth": pointing, "elevation": pointing
        }
        return float(np.radians(limits_arcsec[angle] / 3600.0))

    def input_limits(self, source: str) -> InputLimits:
        """Return the limits of a source: the entry of its name, else of its kind, else ``every_input``."""
        own = self.inputs.get(source.replace(".", "_"))
        return own or self.inputs.get(source.partition(".")[0], self.every_input)


def read_limits(source: Path | str) -> Limits:
    """Read the limits of a ship from YAML.

    Args:
        source: path of a file; a ``str`` is the text itself.

    Raises:
        BadInput: the file cannot be read, or has an unknown key or a value out of range; the error contains file, line,
            key and the expected value.
    """
    file = read_nested_parameters(source)
    try:
        return build(Limits, file.values)
    except ParameterError as error:
        raise file.error(error) from error
