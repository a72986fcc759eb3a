"""Alert sentences, compared with examples of decoders (ALF) and a recorded line (ALC); commands of the bridge."""

import re
from pathlib import Path
from types import SimpleNamespace

import pynmea2
import pytest

from ship_bags.stamps import stamp_fields
from ship_msgs.msg import Alert
from ship_nmea.out.bridge_alerts import SentAlerts
from ship_nmea.sentences.alerts import (
    FIRST_IDENTIFIER,
    LAST_IDENTIFIER,
    LONGEST_BYTES,
    MAX_ALERTS,
    AlertCommand,
    SentenceAlert,
    alc,
    alf,
    arc,
    hbt,
    parse_command,
    text_field,
)

DAY_NS = 1_406_851_200 * 10**9


def time_ns(hour, minute, second):
    return DAY_NS + round(((hour * 60 + minute) * 60 + second) * 1e9)


def render_all(sentences):
    return [sentence.render() for sentence in sentences]


def test_alf_in_one_sentence_equals_decoder_example():
    lost = SentenceAlert(192, 1, 1, 0, "W", "A", time_ns(12, 43, 4.5), "LOST TARGET")
    (sentence,) = alf(lost, "II", "", 0)
    # The example has category A, because the radar picture is needed to decide. The suite gives all its alerts category
    # B.
    sentence.category = "A"
    assert sentence.render() == "$IIALF,1,1,0,124304.50,A,W,A,,192,1,1,0,LOST TARGET*14"


def test_alf_in_two_sentences_equals_decoder_example():
    lost = SentenceAlert(512, 1, 2, 0, "A", "S", time_ns(8, 19, 50.1), "HEADING LOST", "NO SYSTEM HEADING AVAILABLE")
    sentences = alf(lost, "II", "XYZ", 1)
    for sentence in sentences:
        sentence.alert = "0512"
    assert render_all(sentences) == [
        "$IIALF,2,1,1,081950.10,B,A,S,XYZ,0512,1,2,0,HEADING LOST*2D",
        "$IIALF,2,2,1,,,,,XYZ,0512,1,2,0,NO SYSTEM HEADING AVAILABLE*0D",
    ]


def test_empty_alc_equals_recorded_line():
    assert render_all(alc([], "VD", "FEC", 65)) == ["$VDALC,01,01,65,0*6F"]


def test_long_list_is_split_between_alerts():
    alerts = [SentenceAlert(9_990_000 + n, 999_999, 99, 0, "W", "V", 0, "") for n in range(20)]
    found = []
    sentences = alc(alerts, "IN", "ZZZ", 7)
    for number, sentence in enumerate(sentences, start=1):
        text = sentence.render()
        assert len(text) + 2 <= LONGEST_BYTES
        read = pynmea2.parse(text, check=True)
        assert (read.total, read.number, read.sequence) == (len(sentences), number, 7)
        entries = read.data[4:]
        assert len(entries) == 4 * read.entries
        found += [int(identifier) for identifier in entries[1::4]]
    assert found == [alert.identifier for alert in alerts]


def test_text_with_reserved_characters_is_one_field():
    text = "heading σ 3.2″ is over its limit of 2″, $PASHR*00!, because of the star sensor starboard"
    sentences = alf(SentenceAlert(10_000, 1, 1, 0, "A", "V", 0, "A,B*C$DE^F", text), "IN", "ZZZ", 3)
    for sentence in sentences:
        assert len(sentence.render()) + 2 <= LONGEST_BYTES
        assert len(pynmea2.parse(sentence.render(), check=True).data) == 13
    assert sentences[0].text == "A^2CB^2AC^24DE.."  # At most 16 characters; a code such as ^2C is never cut.
    assert sentences[1].text.startswith('heading sigma 3.2" is')


@pytest.mark.parametrize(("text", "most", "field"), [
    ("one two", 7, "one two"),
    ("one two three", 10, "one two.."),
    ("one two three", 8, "one.."),
    ("a^b, and", 9, "a^5Eb.."),
    ("incomprehensible", 10, "incompre.."),
    ("over 3 × the limit ± 2, é 東", 40, "over 3 x the limit +- 2^2C e ?"),
    ("ins: refused", 10, "ins.."),
    ("", 10, ""),
])  # fmt: skip
def test_long_text_is_cut_after_a_word(text, most, field):
    assert text_field(text, most) == field


def test_description_begins_with_the_lost_quantity():
    message = alert("star.fore.out")
    message.text = "Tilt lost, heading over its limit: ins refused in a row"
    (taken,) = SentAlerts().update([message], 0)
    assert alf(taken, "IN", "ZZZ", 1)[1].text == "Tilt lost^2C heading over its limit: ins.."


def test_fields_of_arc_and_hbt():
    refused = arc(AlertCommand(10_001, None, "S"), "IN", "ZZZ", time_ns(1, 2, 3)).render()
    assert refused.rpartition("*")[0] == "$INARC,010203.00,ZZZ,10001,,S"
    assert hbt(True, "IN", 30.0, 12).render().rpartition("*")[0] == "$INHBT,30,A,2"
    assert hbt(False, "IN", 0.5, 3).render().rpartition("*")[0] == "$INHBT,0.5,V,3"


def with_checksum(body):
    return f"${body}*{pynmea2.NMEASentence.checksum(body):02X}"


def test_commands_for_other_sources_are_ignored():
    assert parse_command(with_checksum("IIACN,123519.00,ZZZ,10001,2,A,C"), "ZZZ") == AlertCommand(10_001, 2, "A")
    assert parse_command(with_checksum("IIACN,,ZZZ,10001,,Q,C"), "ZZZ") == AlertCommand(10_001, None, "Q")
    for other in (
        "IIACN,,FEC,10001,2,A,C",  # another source's
        "IIACN,,ZZZ,10001,2,A,",  # no command flag
        "IIHBT,30,A,0",
        "GPZDA,123519.00,01,08,2014,,",
        "IIXYZ,1",  # unknown to the parser
    ):
        assert parse_command(with_checksum(other), "ZZZ") is None


@pytest.mark.parametrize("text", [
    "$IIACN,,ZZZ,10001,2,A,C*00",  # wrong sum
    "$IIACN,,ZZZ,10001,2,A,C",  # no sum
    with_checksum("IIACN,,ZZZ,,2,A,C"),
    with_checksum("IIACN,,ZZZ,ten,2,A,C"),
    with_checksum("IIACN,,ZZZ,10001,x,A,C"),
    with_checksum("IIACN,,ZZZ,10001,2,,C"),
    "", "$", "\x00\xff", "$IIACN", "A" * 5000,
])  # fmt: skip
def test_unreadable_command_raises(text):
    with pytest.raises(ValueError, match=r"."):
        parse_command(text, "ZZZ")


def alert(id_="star.fore.out", instance=1, priority=Alert.WARNING, state=Alert.ACTIVE_UNACKNOWLEDGED, changed_s=5):
    message = Alert(id=id_, instance=instance, priority=priority, state=state, text="star.fore: silent")
    message.changed.sec, message.changed.nanosec = stamp_fields(changed_s * 10**9)
    return message


def test_every_change_is_sent_once_with_the_next_revision():
    ledger = SentAlerts()
    (first,) = ledger.update([alert()], 0)
    assert (first.revision, first.state, first.priority, first.title) == (1, "V", "W", "STAR FORE OUT")
    assert FIRST_IDENTIFIER <= first.identifier <= LAST_IDENTIFIER
    assert ledger.update([alert()], 0) == []
    (seen,) = ledger.update([alert(state=Alert.ACTIVE_ACKNOWLEDGED, changed_s=6)], 0)
    assert (seen.identifier, seen.revision, seen.state) == (first.identifier, 2, "A")
    (over,) = ledger.update([], 9)
    assert (over.identifier, over.revision, over.state, over.changed_ns) == (first.identifier, 3, "N", 9)
    assert ledger.all == []


def test_escalation_is_a_new_instance_after_the_old_one_is_normal():
    """An unacknowledged warning ends, and an alarm with the next instance begins, as in ship_watch."""
    ledger = SentAlerts()
    (warning,) = ledger.update([alert()], 0)
    ended, alarm = ledger.update([alert(instance=2, priority=Alert.ALARM)], 9)
    assert (ended.instance, ended.priority, ended.state, ended.revision, ended.changed_ns) == (1, "W", "N", 2, 9)
    assert (alarm.instance, alarm.priority, alarm.state, alarm.escalation) == (2, "A", "V", 1)
    assert warning.identifier == ended.identifier == alarm.identifier
    (acknowledged,) = ledger.update([alert(instance=2, priority=Alert.ALARM, state=Alert.ACTIVE_ACKNOWLEDGED)], 0)
    assert acknowledged.escalation == 1
    assert [sent.instance for sent in ledger.all] == [2]


def test_recurring_alert_starts_without_escalation():
    ledger = SentAlerts()
    ledger.update([alert()], 0)
    ledger.update([alert(instance=2, priority=Alert.ALARM)], 0)
    ended, again = ledger.update([alert(instance=3, priority=Alert.ALARM)], 0)
    assert [(one.instance, one.state, one.escalation) for one in (ended, again)] == [(2, "N", 1), (3, "V", 0)]


TABLE = Path(__file__).parents[3] / "docs" / "explanation" / "alerts.md"
DEVICES = ("fore", "aft", "port", "starboard", "s330", "mast", "starboard1", "starboard2")
SOURCES = (
    "ins", "encoder", "lights", "baselines", "ship_attitude", "gnss", "weather",
    *(f"star.{device}" for device in DEVICES), *(f"reference.{device}" for device in DEVICES),
)  # fmt: skip
NODES = ("ship_attitude", "optical_axis", "nmea_in", "nmea_out")


def ids_of_the_suite():
    """Return all ids of the table of alerts, with each device, source and node inserted."""
    ids = re.findall(r"^\| `([^`]+)` \|", TABLE.read_text(), re.MULTILINE)
    ids = [id_ for id_ in ids if "." in id_]
    for word, names in (("ID", DEVICES), ("SOURCE", SOURCES), ("NODE", NODES)):
        ids = [filled for id_ in ids for filled in ([re.sub(rf"\b{word}\b", name, id_) for name in names]
                                                    if re.search(rf"\b{word}\b", id_) else [id_])]  # fmt: skip
    return ids


def test_titles_are_unique_and_keep_their_subject():
    ids = ids_of_the_suite()
    assert len(ids) > 100
    titles = {id_: SentAlerts().update([alert(id_)], 0)[0].title for id_ in ids}
    assert max(map(len, titles.values())) <= 16
    assert len(set(titles.values())) == len(set(ids))
    assert titles["attitude.degraded"] == "ATTITUD DEGRADED"
    assert titles["pointing.degraded"] == "POINTIN DEGRADED"
    assert titles["ship_attitude.out"] == "SHIP ATTITUD OUT"
    assert titles["ship_attitude.clock"] == "SHIP ATTIT CLOCK"
    assert titles["star.starboard2.out"] == "STAR STARBO2 OUT"


@pytest.mark.parametrize("id_", ["", "a.b.c.d.e.f.g.h.i.j.k.l", "1234567890123456789.out", "x" * 200])
def test_title_of_any_id_fits(id_):
    (sent,) = SentAlerts().update([alert(id_)], 0)
    for sentence in alf(sent, "IN", "ZZZ", 1):
        assert len(sentence.text) <= 16 or sentence.number == 2
        assert len(sentence.render()) + 2 <= LONGEST_BYTES


def test_alert_numbers_are_unique(monkeypatch):
    monkeypatch.setattr("ship_nmea.out.bridge_alerts.zlib", SimpleNamespace(crc32=lambda _: 9_989_999))
    ledger = SentAlerts()
    one, two = ledger.update([alert("a"), alert("b")], 0)
    assert (one.identifier, two.identifier) == (LAST_IDENTIFIER, FIRST_IDENTIFIER)
    assert ledger.find(AlertCommand(two.identifier, None, "A"))[:2] == ("b", 1)


def test_command_without_instance_refers_to_the_present_one():
    ledger = SentAlerts()
    (sent,) = ledger.update([alert(instance=7)], 0)
    assert ledger.find(AlertCommand(sent.identifier, None, "A"))[:2] == ("star.fore.out", 7)
    assert ledger.find(AlertCommand(sent.identifier, 6, "A"))[:2] == ("star.fore.out", 6)
    assert ledger.find(AlertCommand(sent.identifier + 1, None, "A")) is None


def test_unreadable_list_changes_nothing():
    ledger = SentAlerts()
    ledger.update([alert("a"), alert("b")], 0)
    with pytest.raises(IndexError):
        ledger.update([alert("a"), alert("b", priority=9)], 0)
    assert len(ledger.all) == 2
    assert ledger.update([alert("a"), alert("b")], 0) == []


def test_alerts_beyond_the_maximum_are_counted():
    ledger = SentAlerts()
    sent = ledger.update([alert(f"a{n}") for n in range(MAX_ALERTS + 3)], 0)
    assert len(sent) == MAX_ALERTS
    assert ledger.omitted_count == 3
