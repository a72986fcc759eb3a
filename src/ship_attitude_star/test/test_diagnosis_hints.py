"""Diagnosis hints about wrong headings, at all headings, and the name of the inconsistent source."""

import numpy as np
import pytest

from ship_attitude_star.ship_attitude.decision_effects import consistency_text, heading_hint
from ship_attitude_star.ship_attitude.state import AttitudeResidual
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray

EIGHT = tuple(range(0, 360, 45))
AROUND = (*EIGHT, 39, 42.5, 44, 46, 47.5, 51, 219, 223, 227, 231)


def deck(heading_deg: float) -> FloatArray:
    return rotation_from_angles(*np.deg2rad([heading_deg, 1.0, -2.0]))


def hint(ins_deg: float, measured_deg: float, source: str = "star.fore", ins_confirmed: bool = False) -> str:
    parameter = "references.s330.heading_deg" if source == "reference.s330" else "star_sensors.fore.azimuth_deg"
    return heading_hint(deck(ins_deg), deck(measured_deg), source, parameter, ins_confirmed)


@pytest.mark.parametrize("heading_deg", AROUND)
@pytest.mark.parametrize("off_deg", [0.02, -0.5, 3.0, -8.0])
def test_a_small_disagreement_gets_no_hint_at_any_heading(heading_deg: float, off_deg: float) -> None:
    for source in ("star.fore", "reference.s330"):
        assert hint(heading_deg + off_deg, heading_deg, source) == ""


@pytest.mark.parametrize("heading_deg", [heading for heading in AROUND if heading % 180 != 45])
def test_heading_given_as_yaw_is_named_where_it_makes_a_difference(heading_deg: float) -> None:
    text = hint(90.0 - heading_deg, heading_deg)
    # Within 5° of 45° and 225° heading and yaw differ by less than 10°, which gives no hint.
    assert ("yaw (90° - heading): check ins.convention" in text) == (abs(heading_deg % 180 - 45.0) > 5.0)


@pytest.mark.parametrize("heading_deg", EIGHT)
@pytest.mark.parametrize("turn_deg", [90.0, -90.0, 180.0])
def test_90_and_180_degrees_are_named_at_all_headings(heading_deg: float, turn_deg: float) -> None:
    text = hint(heading_deg + turn_deg, heading_deg)
    # A heading given as yaw takes precedence if this mistake, by far the most common, explains the same difference.
    assert f"about {abs(turn_deg):.0f}° in heading" in text or "yaw (90° - heading)" in text
    by_yaw = abs((2.0 * heading_deg + turn_deg - 90.0 + 180.0) % 360.0 - 180.0) < 5.0
    assert ("yaw" in text) == by_yaw


def test_with_a_confirmed_ins_the_hint_names_the_other_source() -> None:
    assert "ins." not in hint(120.0, 30.0, ins_confirmed=True)
    assert "star_sensors.fore.azimuth_deg" in hint(120.0, 30.0, ins_confirmed=True)
    assert "references.s330.convention" in hint(60.0, 30.0, "reference.s330", ins_confirmed=True)
    for source in ("star.fore", "baseline"):
        assert hint(60.0, 30.0, source, ins_confirmed=True) == ""


def test_a_tilt_difference_is_no_heading_mistake() -> None:
    fallen = rotation_from_angles(*np.deg2rad([120.0, 40.0, -2.0]))
    assert heading_hint(fallen, deck(30.0), "star.fore", "", False) == ""
    assert heading_hint(np.full((3, 3), np.nan), deck(30.0), "star.fore", "", False) == ""


def residual_of(arcsec: tuple[float, float, float], sigma_arcsec: float = 3.0) -> AttitudeResidual:
    return AttitudeResidual(0, np.array(arcsec) * ARCSEC, np.eye(3) * (sigma_arcsec * ARCSEC) ** 2)


MAST, FORE, OTHER = residual_of((300.0, 20.0, 0.0)), residual_of((290.0, 10.0, 5.0)), residual_of((-200.0, 0.0, 400.0))


@pytest.mark.parametrize(
    ("agreeing", "disagreeing", "text"),
    [
        (["star.fore", "star.aft"], {"star.mast": MAST}, "only star.mast differs, star.aft, star.fore agree"),
        (["reference.s330"], {"star.mast": MAST}, "only star.mast differs, reference.s330 agrees with the INS"),
        ([], {"star.mast": MAST}, "no other source shows which of the two is faulty"),
        ([], {"star.mast": MAST, "star.fore": FORE}, "only the INS differs, star.fore, star.mast disagree"),
        ([], {"star.mast": MAST, "star.fore": OTHER}, "star.fore, star.mast disagree with the INS and with each"),
        (["star.aft"], {"star.mast": MAST, "star.fore": FORE}, "star.fore, star.mast disagree with the INS, star.aft"),
    ],
)
def test_the_inconsistent_source_is_named(
    agreeing: list[str], disagreeing: dict[str, AttitudeResidual], text: str
) -> None:
    assert consistency_text("star.mast", agreeing, disagreeing).startswith(text)


def test_noise_about_the_boresight_is_no_disagreement_among_sensors() -> None:
    noisy = AttitudeResidual(0, np.array([150.0, 20.0, 110.0]) * ARCSEC, np.diag([100.0, 3.0, 100.0]) ** 2 * ARCSEC**2)
    assert consistency_text("star.a", [], {"star.a": residual_of((150.0, 20.0, 0.0)), "star.b": noisy}).startswith(
        "only the INS"
    )
