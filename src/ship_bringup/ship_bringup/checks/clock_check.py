"""Check of the computer's clock against UTC, by chrony or PTP. The offset is also expressed as an angle during a turn.

The state is read from the output of ``chronyc tracking`` (chrony's manual page, command ``tracking``) or of
``pmc -u -b 0 'GET TIME_STATUS_NP'`` (linuxptp's manual pages).
"""

import math
import re
import shutil
import subprocess
from dataclasses import dataclass

from ship_bringup.checks.check_line import CheckLine, Result, format_number
from ship_watch.safety.limits import Limits

TURN_DEG_PER_S = 5.0
"""Rate of turn used to express an offset as an angle: a hard turn of a ship."""

_CHECK = "clock"
_CHRONY = ("chronyc", "-n", "tracking")
_PTP = ("pmc", "-u", "-b", "0", "GET TIME_STATUS_NP")
_ANSWER_TIMEOUT_S = 5.0
_NUMBER = r"([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)"
_ADVICE = "set up chrony with the ship's GNSS receiver or time server, or ptp4l and phc2sys"


@dataclass(frozen=True)
class ClockState:
    """State of the computer's clock.

    Attributes:
        source: chrony or PTP; empty if neither is available.
        offset_s: offset of the clock from its source, without sign; NaN if unknown.
        bound_s: maximum error if the source is right (chrony's root distance); NaN if unknown.
        is_synchronised: True if the source reports that it follows a better clock.
        detail: reason for an unknown state, or the status reported by the source.
        is_unresponsive: True if a synchronisation program is installed but gives no usable answer.
    """

    source: str
    offset_s: float = math.nan
    bound_s: float = math.nan
    is_synchronised: bool = False
    detail: str = ""
    is_unresponsive: bool = False


def read_clock_state() -> ClockState:
    """Read the state of the clock from chrony or, without a usable answer of chrony, from PTP."""
    details, is_unresponsive = [], False
    for command, read in ((_CHRONY, chrony_state), (_PTP, ptp_state)):
        if shutil.which(command[0]) is None:
            details.append(f"no {command[0]}")
            continue
        is_unresponsive = True
        try:
            run = subprocess.run(command, capture_output=True, text=True, timeout=_ANSWER_TIMEOUT_S, check=False)
        except subprocess.TimeoutExpired:
            details.append(f"{command[0]} gave no answer within {_ANSWER_TIMEOUT_S:g} s")
            continue
        state = read(run.stdout)
        if state is not None:
            return state
        output_lines = (run.stderr or run.stdout).strip().splitlines()
        details.append(f"{command[0]} reports: {output_lines[-1] if output_lines else 'nothing'}")
    return ClockState("", detail=", ".join(details), is_unresponsive=is_unresponsive)


def chrony_state(text: str) -> ClockState | None:
    """Return the state printed by ``chronyc tracking``; None for any other text."""
    offset = re.search(rf"^System time\s*: {_NUMBER} seconds (?:slow|fast) of NTP time", text, re.MULTILINE)
    leap = re.search(r"^Leap status\s*: (.+)$", text, re.MULTILINE)
    if offset is None or leap is None:
        return None
    offset_s = abs(float(offset[1]))
    bound_s = offset_s + _root_s("dispersion", text) + 0.5 * _root_s("delay", text)
    return ClockState("chrony", offset_s, bound_s, leap[1].strip() != "Not synchronised", leap[1].strip())


def _root_s(name: str, text: str) -> float:
    found = re.search(rf"^Root {name}\s*: {_NUMBER} seconds", text, re.MULTILINE)
    return float(found[1]) if found else math.nan


def ptp_state(text: str) -> ClockState | None:
    """Return the state printed by ``pmc`` for TIME_STATUS_NP; None for any other text."""
    offset = re.search(rf"^\s*master_offset\s+{_NUMBER}\s*$", text, re.MULTILINE)
    present = re.search(r"^\s*gmPresent\s+(true|false)\s*$", text, re.MULTILINE)
    if offset is None or present is None:
        return None
    detail = "offset of the network card's clock: check that phc2sys runs"
    return ClockState("PTP", abs(float(offset[1])) * 1e-9, math.nan, present[1] == "true", detail)


def check_clock(state: ClockState, limits: Limits) -> CheckLine:
    """Check the clock against the ship's limits: FAIL above the clock's limit, WARN above the heading's limit.

    A clock that is not synchronised, or installed programs without a usable answer, are a FAIL. A computer without
    chrony and PTP is a WARN.
    """
    if state.is_unresponsive:
        found = f"no answer about the clock: {state.detail}"
        return CheckLine(_CHECK, Result.FAIL, found, "look at systemctl status chrony, or start ptp4l and phc2sys")
    if not state.source:
        return CheckLine(_CHECK, Result.WARN, f"neither chrony nor PTP: {state.detail}", _ADVICE)
    if not state.is_synchronised:
        return CheckLine(_CHECK, Result.FAIL, f"{state.source} is not synchronised ({state.detail})", _ADVICE)
    turn_arcsec = turn_angle_arcsec(state.offset_s)
    found = f"{state.source}: {format_number(state.offset_s * 1e3)} ms off, {format_number(turn_arcsec)}\""
    found += f" at {TURN_DEG_PER_S:g} deg/s"
    if math.isfinite(state.bound_s):
        bound_arcsec = turn_angle_arcsec(state.bound_s)
        found += f" (error bound {format_number(state.bound_s * 1e3)} ms, {format_number(bound_arcsec)}\")"
    if not state.offset_s <= limits.machine.clock_offset_s:
        over = f"over machine.clock_offset_s, {limits.machine.clock_offset_s * 1e3:g} ms"
        return CheckLine(_CHECK, Result.FAIL, f"{found}: {over}", "wait until it has settled: chronyc waitsync")
    if not turn_arcsec <= limits.heading_arcsec:
        advice = "wait until it has settled, or use a nearer source: a GNSS receiver with PPS"
        return CheckLine(_CHECK, Result.WARN, f"{found}: over heading_arcsec, {limits.heading_arcsec:g}\"", advice)
    return CheckLine(_CHECK, Result.OK, found)


def turn_angle_arcsec(offset_s: float) -> float:
    """Return the angle of a turn at :data:`TURN_DEG_PER_S` in a time, arcsec: 18 per millisecond."""
    return TURN_DEG_PER_S * 3600.0 * offset_s
