"""The attitude as sentences: printed examples, byte for byte; signs; rounding; void fields.

Sources: a Seapath 320's lines in the data description of NCEI accession 0086548 (PSXN, HDT; fields by Kongsberg
M300-62), Navis NavDP 4000, 000.JDP-10000-OME (THS), NovAtel OEM7 (PASHR). The suite does not estimate heave; the test
inserts it if an example has it.
"""

import math

import numpy as np
import pynmea2
import pytest

from ship_geometry.frames import angles_from_rotation, rotation_from_angles
from ship_geometry.rotations import ARCSEC
from ship_nmea.sentences.alerts import LONGEST_BYTES
from ship_nmea.sentences.attitude import (
    ATTITUDE_SENTENCES,
    AttitudeQuality,
    SentenceAttitude,
    hdt,
    heading_rate,
    pashr,
    psxn20,
    psxn23,
    rot,
    simulated_attitude,
    ths,
)

MIDNIGHT_NS = 1_406_851_200 * 10**9
"""2014-08-01T00:00:00Z."""


def attitude(
    heading_deg, pitch_deg, roll_deg, worth=AttitudeQuality.NORMAL, sigmas_deg=(0.01, 0.01, 0.01), time_ns=MIDNIGHT_NS
):
    angles = tuple(math.radians(angle) for angle in (heading_deg, pitch_deg, roll_deg))
    return SentenceAttitude(time_ns, worth, angles, tuple(math.radians(sigma) for sigma in sigmas_deg), 0.0)


def test_hdt_and_psxn23_equal_a_seapath_320():
    shown = attitude(104.68, 1.93, 1.28)
    assert hdt(shown, "GP", 2).render() == "$GPHDT,104.68,T*0E"
    sentence = psxn23(shown, "", 2)
    sentence.heave = "-0.24"
    assert sentence.render() == "$PSXN,23,1.28,1.93,104.68,-0.24*18"


def test_psxn20_equals_a_seapath_320():
    sentence = psxn20(attitude(104.68, 1.93, 1.28), "", 2)
    assert sentence.render() == "$PSXN,20,2,2,0,0*3B"  # 2 xor 2 gives the same checksum as 0, 0
    sentence.horiz_qual = sentence.hgt_qual = "0"
    assert sentence.render() == "$PSXN,20,0,0,0,0*3B"


def test_ths_of_an_estimated_heading_equals_the_navdp_manual():
    assert ths(attitude(316.70, 0.0, 0.0, AttitudeQuality.ESTIMATED), "HE", 2).render() == "$HETHS,316.70,E*1A"


def test_pashr_equals_the_novatel_manual():
    time_ns = MIDNIGHT_NS + ((16 * 60 + 30) * 60 + 29) * 10**9
    shown = attitude(158.09, 0.31, -0.30, sigmas_deg=(0.059, 0.029, 0.029), time_ns=time_ns)
    sentence = pashr(shown, "", 2)
    sentence.heave = "+0.01"
    assert sentence.render() == "$PASHR,163029.000,158.09,T,-0.30,+0.31,+0.01,0.029,0.029,0.059,1,1*3B"


def test_rot_is_in_degrees_per_minute_and_negative_to_port():
    shown = SentenceAttitude(
        MIDNIGHT_NS, AttitudeQuality.NORMAL, (1.0, 0.0, 0.0), heading_rate=math.radians(-35.6 / 60.0)
    )
    assert rot(shown, "GP", 1).render().startswith("$GPROT,-35.6,A*")


@pytest.mark.parametrize("name", ATTITUDE_SENTENCES)
def test_void_attitude_has_void_fields_and_status(name):
    sentence = ATTITUDE_SENTENCES[name](SentenceAttitude(MIDNIGHT_NS), "IN", 4).render()
    assert sentence.rpartition("*")[0] == {
        "HDT": "$INHDT,,T",
        "THS": "$INTHS,,V",
        "ROT": "$INROT,,V",
        "PASHR": "$PASHR,000000.000,,,,,,,,,0,0",
        "PSXN20": "$PSXN,20,2,2,2,2",
        "PSXN23": "$PSXN,23,,,,",
    }[name]


@pytest.mark.parametrize("name", ATTITUDE_SENTENCES)
def test_only_ths_is_valid_for_a_played_attitude(name):
    shown = simulated_attitude(name, attitude(10.0, 1.0, 2.0, AttitudeQuality.SIMULATED))
    assert ATTITUDE_SENTENCES[name](shown, "IN", 1).render().rpartition("*")[0] == {
        "HDT": "$INHDT,,T",
        "THS": "$INTHS,10.0,S",
        "ROT": "$INROT,,V",
        "PASHR": "$PASHR,000000.000,,,,,,,,,0,0",
        "PSXN20": "$PSXN,20,2,2,2,2",
        "PSXN23": "$PSXN,23,,,,",
    }[name]


@pytest.mark.parametrize(("worth", "mode", "quality"), [
    (AttitudeQuality.NORMAL, "A", 0), (AttitudeQuality.ESTIMATED, "E", 1), (AttitudeQuality.SIMULATED, "S", 1),
])  # fmt: skip
def test_status_follows_from_quality(worth, mode, quality):
    shown = attitude(10.0, 1.0, 2.0, worth)
    assert pynmea2.parse(ths(shown, "IN", 3).render(), check=True).mode == mode
    read = pynmea2.parse(psxn20(shown, "IN", 3).render(), check=True)
    assert (read.head_qual, read.rp_qual) == (quality, quality)


ANGLES = [
    *((heading, 1.234567, -2.345678) for heading in (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)),
    (359.99999999, 0.0, 0.0), (180.0, 10.0, 179.99999), (180.0, -10.0, -179.99999), (12.3456789, 89.0, 30.0),
    (0.00000001, -0.00000001, -0.00000001),
]  # fmt: skip


@pytest.mark.parametrize("angles", ANGLES)
@pytest.mark.parametrize("decimals", [1, 2, 4, 7])
def test_another_parser_reads_back_all_digits(angles, decimals):
    half = 0.5000001 * 10.0**-decimals
    shown = attitude(*angles)
    for text in (f"{make(shown, 'IN', decimals)}" for make in (hdt, ths, pashr, psxn23)):
        assert decimals > 4 or len(text) + 2 <= LONGEST_BYTES
        assert not any(word in text for word in (",360", ",-0.0,", "-0.0000000,", "nan"))
        read = pynmea2.parse(text, check=True)
        heading = next(
            getattr(read, name) for name in ("heading", "true_heading", "head") if name in type(read).name_to_idx
        )
        assert 0.0 <= float(heading) < 360.0
        assert abs((float(heading) - angles[0] + 180.0) % 360.0 - 180.0) <= half
        if "roll" in type(read).name_to_idx:
            assert abs(read.pitch - angles[1]) <= half
            assert abs(read.roll - angles[2]) <= half


def test_zero_has_no_minus():
    shown = attitude(359.999, -0.0004, -0.0004)
    assert psxn23(shown, "", 2).render().startswith("$PSXN,23,0.00,0.00,0.00,*")
    assert ",0.00,T,+0.00,+0.00,," in pashr(shown, "", 2).render()


@pytest.mark.parametrize(("sigma_deg", "printed"), [
    (1e-12, "0.00001"), (0.00001, "0.00001"), (0.0000101, "0.00002"), (2.0, "2.00000"), (math.nan, ""),
    (math.inf, ""),
])  # fmt: skip
def test_sigma_is_rounded_up_and_never_to_zero(sigma_deg, printed):
    fields = pashr(attitude(1.0, 2.0, 3.0, sigmas_deg=(sigma_deg,) * 3), "", 4).render().split(",")
    assert fields[7:10] == [printed] * 3


def test_sigmas_are_in_the_order_roll_pitch_heading():
    fields = pashr(attitude(1.0, 2.0, 3.0, sigmas_deg=(0.3, 0.2, 0.1)), "", 1).render().split(",")
    assert fields[7:10] == ["0.10", "0.20", "0.30"]


@pytest.mark.parametrize(("before_ns", "printed"), [
    (1, "000000.000"), (500_000, "000000.000"), (500_001, "235959.999"), (1_000_000, "235959.999"),
])  # fmt: skip
def test_time_just_before_midnight_is_not_hour_24(before_ns, printed):
    time_ns = MIDNIGHT_NS - before_ns
    assert pashr(attitude(1.0, 2.0, 3.0, time_ns=time_ns), "", 4).render().split(",")[1] == printed


def test_default_decimals_show_star_sensor_accuracy():
    """The standard deviations are 0.3″, which a field with steps of 0.001° could not show."""
    shown = attitude(1.0, 2.0, 3.0, sigmas_deg=(math.degrees(0.3 * ARCSEC),) * 3)
    read = pynmea2.parse(pashr(shown, "", 4).render(), check=True)
    assert 0.3 <= read.heading_accuracy * 3600.0 <= 0.34


@pytest.mark.parametrize("angles_deg", [(10.0, 0.0, 0.0), (350.0, 20.0, -15.0), (180.0, -35.0, 40.0)])
def test_heading_rate_is_the_derivative_of_heading(angles_deg):
    """The expected rate is the change of heading in 1 µs, by the rotations of ship_geometry."""
    rate_flu = np.array([0.02, -0.03, 0.05])
    rotation_nd = rotation_from_angles(*np.radians(angles_deg))
    step_s = 1e-6
    # Rotation vector of the step in the deck frame (forward, up, right).
    forward, left, up = rate_flu
    x, y, z = np.array([forward, up, -left]) * step_s
    turn = np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
    later = angles_from_rotation(rotation_nd @ turn)
    expected = (later[0] - math.radians(angles_deg[0]) + math.pi) % (2.0 * math.pi) - math.pi
    rate = heading_rate(math.radians(angles_deg[1]), math.radians(angles_deg[2]), tuple(rate_flu))
    assert rate == pytest.approx(expected / step_s, abs=1e-5)


def test_no_rate_of_turn_at_the_zenith():
    assert math.isnan(heading_rate(math.radians(89.95), 0.0, (0.0, 0.0, 0.1)))
    assert math.isnan(heading_rate(math.nan, 0.0, (0.0, 0.0, 0.1)))
