"""Sentences of common makers, each from a manual or a log; further fields of PASHR."""

import numpy as np
import pytest

from ship_bags.message_store import RosbagsFactory
from ship_bags.nmea.instrument import GYRO, INS, REFERENCE, Instrument, InstrumentRole
from ship_bags.nmea.instrument_lines import InstrumentLine, LineReport, parse_line
from ship_bags.nmea.sentences import DIALECTS, NotOfInterest, Sentence, Unusable
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_geometry.frames import angles_from_rotation, rotation_from_quaternion
from ship_testing.ship_logs import sentence

SENTENCES = {
    "PRDID": ("$PRDID,-4.44,2.12,154.25*56", (154.25, -4.44, 2.12)),
    "PTNTHPR": ("$PTNTHPR,59.6,N,-0.2,N,-3.0,N*0F", (59.6, -0.2, -3.0)),
    "PSAT,HPR": (sentence("PSAT,HPR,235410.50,89.58,3.35,-0.21,N"), (89.58, 3.35, -0.21)),
    "ROT": (sentence("HEROT,-30.0,A"), None),
}
"""Kind → a sentence, and its heading, pitch (bow up) and roll (starboard down), degrees."""

RECEIVE_NS = 1_268_178_851 * NS_PER_S
"""2010-03-09T23:54:11Z."""


def parse_results(text, needs_checksum=True):
    (line,) = parse_line(text.encode(), needs_checksum)
    return line.result


def messages_of(becomes, *texts, by_instrument=True):
    """Return the messages of sentences received one after the other, and the report."""
    report = LineReport("test")
    instrument = Instrument(RosbagsFactory(), InstrumentRole(becomes, by_instrument), "a", report)
    found = []
    for text in texts:
        result = parse_results(text)
        if isinstance(result, Sentence):
            found += instrument.take(InstrumentLine(1, RECEIVE_NS, result.kind, result.content))
    return [message for _, _, message in found], report


def angles_deg(message):
    q = message.orientation
    return np.rad2deg(angles_from_rotation(rotation_from_quaternion(np.array([q.x, q.y, q.z, q.w]))))


@pytest.mark.parametrize("kind", DIALECTS)
def test_each_row_is_read(kind):
    text, expected = SENTENCES[kind]
    assert parse_results(text).kind == kind
    assert str(parse_results(text).content) == text
    if expected is not None:
        (message,), _ = messages_of(REFERENCE, text, by_instrument="PSAT" in text)
        assert angles_deg(message) == pytest.approx(expected)


@pytest.mark.parametrize("kind", ["PRDID", "PTNTHPR"])
def test_a_sentence_without_time_uses_the_zda_of_its_burst(kind):
    (message,), _ = messages_of(INS, sentence("GPZDA,235410.00,09,03,2010,,"), SENTENCES[kind][0])
    assert ns_from_stamp(message.header.stamp) == RECEIVE_NS - NS_PER_S


def test_a_sentence_with_time_has_its_own():
    (message,), _ = messages_of(INS, SENTENCES["PSAT,HPR"][0])
    assert ns_from_stamp(message.header.stamp) == RECEIVE_NS - NS_PER_S // 2


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("$PTNTHPR,,N,-1.5,N,,P*03", "PTNTHPR: a field or its status cannot be used"),  # roll beyond the alarm
        ("$PTNTHPR,90,N,29,N,15,N*1C", "PTNTHPR: a field or its status cannot be used"),  # mils
        ("$PSAT,HPR,235410.50,89.58,3.35,,N*01", "no values in it"),  # of a log: two antennas give no roll
        (sentence("PSAT,HPR,250000.00,89.58,3.35,1.0,N"), "PSAT,HPR: a field or its status cannot be used"),
        (sentence("PRDID,1.0,2.0"), "PRDID: a field or its status cannot be used"),
        (sentence("PRDID,1.0,2.0,361.0"), "angle out of range"),
        ("$PRDID,-4.44,2.12,154.26*56", "checksum failed"),
    ],
)
def test_unusable_sentences_are_rejected_with_the_reason(text, reason):
    result = parse_results(text)
    assert isinstance(result, Unusable)
    assert (result.detail or result.reason) == reason


def test_a_high_warning_is_no_alarm():
    assert parse_results("$PTNTHPR,72.9,N,-1.6,N,-29.6,O*33").content.roll == -29.6


@pytest.mark.parametrize("kind", DIALECTS)
def test_truncated_sentences_without_checksum_are_not_used(kind):
    whole = SENTENCES[kind][0].partition("*")[0]
    assert isinstance(parse_results(whole, needs_checksum=False), Sentence)
    for end in range(len(whole)):
        assert not isinstance(parse_results(whole[:end], needs_checksum=False), Sentence) if end else True


def test_a_heading_has_the_turn_rate_of_its_burst():
    """30 °/min to port are half a degree per second, negative about down and positive about up."""
    (message,), _ = messages_of(GYRO, SENTENCES["ROT"][0], sentence("HEHDT,10.0,T"))
    assert message.angular_velocity.z == pytest.approx(np.deg2rad(0.5))
    assert message.angular_velocity_covariance[0] == 1.0
    assert message.angular_velocity_covariance[8] == pytest.approx(np.deg2rad(0.5 / 60.0) ** 2)


@pytest.mark.parametrize("rot", ["HEROT,,V", "HEROT,30.0,V", "HEROT,30.0"])
def test_a_heading_without_a_valid_turn_rate_has_none(rot):
    assert parse_results(sentence(rot)) == NotOfInterest("HEROT")
    (message,), _ = messages_of(GYRO, sentence(rot), sentence("HEHDT,10.0,T"))
    assert message.angular_velocity_covariance[0] == -1.0


def pashr(accuracies):
    return sentence(f"PASHR,235410.50,90.0,T,-0.83,-0.42,-0.01,{accuracies},2,1")


def test_the_sigmas_of_a_pashr_are_those_of_the_ins_about_east_north_and_up():
    """Bow east: roll is about east, pitch about north."""
    (message,), _ = messages_of(INS, pashr("0.010,0.020,0.030"))
    covariance = message.orientation_covariance.reshape(3, 3)
    assert np.rad2deg(np.sqrt(np.diag(covariance))) == pytest.approx([0.01, 0.02, 0.03])
    assert np.abs(covariance - np.diag(np.diag(covariance))).max() < 1e-12
    (message,), _ = messages_of(REFERENCE, pashr("0.010,0.020,0.030"))
    assert not message.orientation_covariance.any()


@pytest.mark.parametrize("accuracies", [",,", "0.010,0.020,", "0.000,0.020,0.030", "999.999,0.020,0.030", "nan,1,1"])
def test_invalid_sigmas_leave_the_configured_ones(accuracies):
    (message,), _ = messages_of(INS, pashr(accuracies))
    assert not message.orientation_covariance.any()
