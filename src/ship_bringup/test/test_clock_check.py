"""Output of chrony and PTP, and the resulting angle during a turn of the ship.

The texts are printed examples: of ``chronyc tracking`` in Fedora's guide for administrators, of ``pmc`` in Red Hat's,
"Using the PTP Management Client". An unsynchronised clock has the leap status that chronyc(1) names for it.
"""

import math
import shutil
from pathlib import Path

import pytest

from ship_bringup.checks.check_line import Result
from ship_bringup.checks.clock_check import (
    ClockState,
    check_clock,
    chrony_state,
    ptp_state,
    read_clock_state,
    turn_angle_arcsec,
)
from ship_watch.safety.limits import Limits

CHRONY = """\
Reference ID    : 1.2.3.4 (a.b.c)
Stratum         : 3
Ref time (UTC)  : Fri Feb  3 15:00:29 2012
System time     : 0.000001501 seconds slow of NTP time
Last offset     : -0.000001632 seconds
RMS offset      : 0.000002360 seconds
Frequency       : 331.898 ppm fast
Residual freq   : 0.004 ppm
Skew            : 0.154 ppm
Root delay      : 0.373169 seconds
Root dispersion : 0.024780 seconds
Update interval : 64.2 seconds
Leap status     : Normal
"""
NEVER_SYNCHRONISED = """\
Reference ID    : 00000000 ()
Stratum         : 0
Ref time (UTC)  : Thu Jan 01 00:00:00 1970
System time     : 0.000000000 seconds fast of NTP time
Last offset     : +0.000000000 seconds
RMS offset      : 0.000000000 seconds
Frequency       : 0.000 ppm slow
Residual freq   : +0.000 ppm
Skew            : 0.000 ppm
Root delay      : 1.000000000 seconds
Root dispersion : 1.000000000 seconds
Update interval : 0.0 seconds
Leap status     : Not synchronised
"""
PTP = """\
sending: GET TIME_STATUS_NP
        90e2ba.fffe.20c7f8-0 seq 0 RESPONSE MANAGMENT TIME_STATUS_NP
                master_offset              310
                ingress_time               1361545089345029441
                cumulativeScaledRateOffset   +1.000000000
                scaledLastGmPhaseChange    0
                gmTimeBaseIndicator        0
                lastGmPhaseChange          0x0000'0000000000000000.0000
                gmPresent                  true
                gmIdentity                 00a069.fffe.0b552d
"""


def test_millisecond_is_eighteen_arcseconds_at_five_degrees_per_second():
    """5 deg/s x 0.001 s = 0.005 deg = 18 arcsec."""
    assert turn_angle_arcsec(1e-3) == pytest.approx(18.0)


def test_chrony_output():
    state = chrony_state(CHRONY)
    assert (state.source, state.is_synchronised, state.offset_s) == ("chrony", True, 1.501e-6)
    # The manual: clock_error <= |system_time_offset| + root_dispersion + 0.5 x root_delay.
    assert state.bound_s == pytest.approx(1.501e-6 + 0.024780 + 0.5 * 0.373169)
    row = check_clock(state, Limits())
    assert row.result is Result.OK
    assert row.finding.startswith('chrony: 0.0015 ms off, 0.027" at 5 deg/s (error bound 211 ms, 3805")')


def test_sign_of_the_offset_is_ignored():
    assert chrony_state(CHRONY.replace("slow of", "fast of")).offset_s == 1.501e-6


def test_unsynchronised_clock_fails_at_zero_offset():
    state = chrony_state(NEVER_SYNCHRONISED)
    assert (state.offset_s, state.is_synchronised) == (0.0, False)
    assert check_clock(state, Limits()).result is Result.FAIL


@pytest.mark.parametrize(
    ("offset", "result", "text"),
    [("0.000277000", Result.OK, '4.99"'), ("0.000278000", Result.WARN, '5" at 5 deg/s'),
     ("0.001000000", Result.WARN, '1 ms off, 18"'), ("0.050000000", Result.WARN, '900"'),
     ("0.050100000", Result.FAIL, "over machine.clock_offset_s, 50 ms")],
)  # fmt: skip
def test_offset_limits_of_heading_and_stamps(offset, result, text):
    """5 arcsec, the limit of the heading here, are 0.2778 ms at 5 deg/s."""
    row = check_clock(chrony_state(CHRONY.replace("0.000001501", offset)), Limits(heading_arcsec=5.0))
    assert row.result is result
    assert text in row.finding


def test_ptp_output():
    state = ptp_state(PTP)
    assert (state.source, state.is_synchronised) == ("PTP", True)
    assert state.offset_s == pytest.approx(310e-9)
    assert check_clock(state, Limits()).result is Result.OK
    assert ptp_state(PTP.replace(" 310", " -310")).offset_s == pytest.approx(310e-9)


def test_ptp_without_grandmaster_fails():
    assert check_clock(ptp_state(PTP.replace("true", "false")), Limits()).result is Result.FAIL


@pytest.mark.parametrize("text", ["", "506 Cannot talk to daemon", PTP, CHRONY[:100], CHRONY.replace("0.0000", "x")])
def test_other_text_is_no_chrony_state(text):
    assert chrony_state(text) is None


@pytest.mark.parametrize("text", ["", "sending: GET TIME_STATUS_NP\n", CHRONY])
def test_other_text_is_no_ptp_state(text):
    assert ptp_state(text) is None


def test_nan_offset_fails():
    assert check_clock(ClockState("chrony", math.nan, math.nan, True), Limits()).result is Result.FAIL


def program(folder: Path, name: str, text: str, code: int = 0):
    path = folder / name
    path.write_text(f"#!/bin/sh\ncat <<'END'\n{text}END\nexit {code}\n")
    path.chmod(0o755)


def test_chrony_before_ptp_and_failure_without_answer(tmp_path, monkeypatch):
    # Only what the programs here need is in PATH: this computer may have chrony itself.
    (tmp_path / "cat").symlink_to(shutil.which("cat"))
    monkeypatch.setenv("PATH", str(tmp_path))
    row = check_clock(read_clock_state(), Limits())
    assert (row.result, row.finding) == (Result.WARN, "neither chrony nor PTP: no chronyc, no pmc")
    assert row.advice.startswith("set up chrony")
    program(tmp_path, "chronyc", "506 Cannot talk to daemon\n", 1)
    row = check_clock(read_clock_state(), Limits())
    found = "no answer about the clock: chronyc reports: 506 Cannot talk to daemon, no pmc"
    assert (row.result, row.finding) == (Result.FAIL, found)
    program(tmp_path, "pmc", PTP)
    assert read_clock_state().source == "PTP"
    program(tmp_path, "chronyc", CHRONY)
    assert read_clock_state().source == "chrony"
