"""Mounting shifts: an excluded device that is reinstated with other installation angles; hand-made covariances."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ship_geometry.rotations import ARCSEC
from ship_watch.sources.source_history import DISPLAY_TIME_NS, MountingShifts
from ship_watch.suite_state import Presence, SourceState

SECOND = 1_000_000_000
UTC = 1_404_906_607 * SECOND
IN = SourceState("star.bow", Presence.IN, "", "", math.nan, 0, "")
OUT = SourceState("star.bow", Presence.OUT, "excluded", "", math.nan, UTC + 20 * SECOND, "")
NOMINAL = np.deg2rad([30.0, 60.0, 5.0])


def alignment(second: float, shift: Any = 0.0, sigma: float = 3.0, device: str = "star.bow") -> SimpleNamespace:
    """Return an AlignmentState with an INS angle and the angles of a device, shifted by ``shift`` (arcsec)."""
    ends = ("azimuth", "elevation", "roll") if device.startswith("star") else ("roll", "pitch", "heading")
    angles = NOMINAL + np.asarray(shift) * ARCSEC
    if device.startswith("reference"):
        angles = angles[::-1]
    ns = UTC + round(second * SECOND)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=ns // SECOND, nanosec=ns % SECOND)),
        names=["ins.up", *(f"{device}.{end}" for end in ends)],
        values=np.array([0.0, *angles]),
        covariance=np.diag([1e-9, *[(sigma * ARCSEC) ** 2] * 3]).ravel(),
    )


def texts(shift: Any, sigma: float = 3.0, device: str = "star.bow") -> tuple[list[str], MountingShifts]:
    """Return event texts and shifts of a voyage: the device is OUT from 21 s to 80 s, then IN with a shift."""
    shifts, found = MountingShifts(), []
    for second in range(120):
        is_out = 21 <= second < 80
        # From 20 s on the fault has changed the estimate; the covariance is inflated until 80 s.
        wide = 20 <= second < 80
        shifts.record_alignment(alignment(second, shift if second >= 20 else 0.0, 200.0 if wide else sigma, device))
        source = replace(OUT if is_out else IN, name=device)
        found += [text for _, text in shifts.record_sources([source], UTC + second * SECOND)]
    return found, shifts


@pytest.mark.parametrize("device", ["star.bow", "reference.mast"])
def test_reinstatement_with_a_shift_is_an_event(device: str) -> None:
    """50″ in elevation (or pitch) is one event with the angle between the mountings, displayed for ten minutes."""
    found, shifts = texts([0.0, 50.0, 0.0], device=device)
    assert found == [f"{device} reinstated, mounting shifted by 50″"]
    assert shifts.shift_of(device, UTC + 200 * SECOND) / ARCSEC == pytest.approx(50.0, abs=1e-6)
    assert math.isnan(shifts.shift_of(device, UTC + 80 * SECOND + 2 * DISPLAY_TIME_NS))


def test_azimuth_shift_is_an_angle_of_rotation() -> None:
    """100″ of azimuth at 60° elevation with unchanged roll is a rotation of 100″ about Up."""
    found, _ = texts([100.0, 0.0, 0.0])
    assert found == ["star.bow reinstated, mounting shifted by 100″"]


@pytest.mark.parametrize(("shift", "sigma"), [(5.0, 3.0), (50.0, 60.0), (math.nan, 3.0), (50.0, math.nan), (0.0, 0.0)])
def test_insignificant_or_unknown_shift_is_ignored(shift: float, sigma: float) -> None:
    """No shift below the threshold, for unknown angles, and for an unknown or zero covariance."""
    assert texts([0.0, shift, 0.0], sigma)[0] == []


def test_source_out_because_of_another_has_no_shift() -> None:
    """Star sensors that are OUT because of the INS have no mounting shift."""
    shifts = MountingShifts()
    for second in range(40):
        shifts.record_alignment(alignment(second, [0.0, 50.0 if second > 20 else 0.0, 0.0]))
        needs = replace(OUT, reason="needs ins", because_of="ins") if 10 < second < 30 else IN
        assert shifts.record_sources([needs], UTC + second * SECOND) == []
