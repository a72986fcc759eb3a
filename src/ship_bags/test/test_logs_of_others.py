"""Logs as others write them: without checksums, with offsets in the times, ZDA last, two receivers, GPS time.

Each log is made here from known values, so the expected stamps, headings and positions are those put in.
"""

import itertools
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from ship_bags.commands.import_nmea import main
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.nmea.instrument_lines import datetime_ns, parse_line
from ship_bags.nmea.sentences import Sentence
from ship_bags.stamps import ns_from_stamp
from ship_geometry.frames import angles_from_rotation, rotation_from_quaternion
from ship_testing.ship_logs import sentence

START = datetime(2026, 5, 4, 22, 10, tzinfo=timezone.utc)
START_NS = datetime_ns(START)
POSITION = "4712.3456,N,01020.5000,W"


def line_received_at(time_s, text):
    return f"{START + timedelta(seconds=time_s):%Y-%m-%dT%H:%M:%S.%f}Z {text}\n"


def clock(time_s):
    return f"{START + timedelta(seconds=time_s):%H%M%S.%f}"[:-4]


def zda(time_s, talker="GP"):
    return sentence(f"{talker}ZDA,{clock(time_s)},04,05,2026,,")


def gga(time_s, talker="GP", position=POSITION, quality=1):
    return sentence(f"{talker}GGA,{clock(time_s)},{position},{quality},10,0.9,12.3,M,48.1,M,,")


def heading_deg(time_s):
    return 200.0 + time_s


def psxn(time_s):
    return sentence(f"PSXN,23,1.00,2.00,{heading_deg(time_s):.2f},0.20")


def pashr(time_s):
    return sentence(f"PASHR,{clock(time_s)},{heading_deg(time_s):.2f},T,+1.00,+2.00,,0.02,0.02,0.05,1,1")


@pytest.fixture
def import_logs(tmp_path, capsys):
    """Import logs; return topic → messages, and the printed text."""

    def run(*options, **logs):
        arguments = list(options)
        for name, text in logs.items():
            (tmp_path / f"{name}.log").write_text(text)
            arguments += [f"--{name}", str(tmp_path / f"{name}.log")]
        assert main([*arguments, "--out", str(tmp_path / "out.mcap"), "--force"]) == 0
        found = {}
        with read_bag(tmp_path / "out.mcap") as bag:
            for record in bag.records():
                found.setdefault(record.topic, []).append((record.log_time_ns, record.decode()))
        return found, capsys.readouterr().out

    return run


def stamps_s(messages):
    return [round((ns_from_stamp(message.header.stamp) - START_NS) * 1e-9, 3) for _, message in messages]


def headings_deg(messages):
    quaternions = [message.orientation for _, message in messages]
    rotations = rotation_from_quaternion(np.array([[q.x, q.y, q.z, q.w] for q in quaternions]))
    return np.rad2deg([angles_from_rotation(rotation)[0] for rotation in rotations]) % 360.0


def assert_stamped_when_measured(messages, count):
    """Check the stamps by the headings, which were computed from the time of each attitude."""
    assert len(messages) == count
    np.testing.assert_allclose(
        headings_deg(messages), [heading_deg(time_s) for time_s in stamps_s(messages)], atol=0.006
    )


# -- without a checksum ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "$HEHDT,218.53,T", "$HETHS,218.53,A", "$PSXN,23,0.35,-1.74,218.26,0.58", "$PSXN,20,1,0,0,0",
        "$PASHR,221000.000,218.00,T,+0.00,+0.39,+0.10,0.020,0.020,0.050,1,1", "$GPZDA,221000.00,04,05,2026,,",
        "$GPGGA,221000.00,4712.3456,N,01020.5000,W,1,10,0.9,12.3,M,48.1,M,,",
    ],
)  # fmt: skip
def test_complete_sentences_without_checksum_are_used_only_on_request(text):
    def is_used(line, needs_checksum):
        return any(isinstance(parsed.result, Sentence) for parsed in parse_line(line.encode(), needs_checksum))

    assert is_used(text, needs_checksum=False)
    assert not is_used(text, needs_checksum=True)
    assert [text[:end] for end in range(1, len(text)) if is_used(text[:end], needs_checksum=False)] == []
    with_checksum = sentence(text[1:])
    assert [end for end in range(1, len(with_checksum)) if is_used(with_checksum[:end], needs_checksum=True)] == []


def test_a_log_without_checksums_is_refused_by_default(import_logs, tmp_path, capsys):
    text = "".join(line_received_at(time_s + 0.1, pashr(time_s).partition("*")[0]) for time_s in range(5))
    (tmp_path / "ins.log").write_text(text)
    assert main(["--ins", str(tmp_path / "ins.log"), "--out", str(tmp_path / "out.mcap")]) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert "half line or no checksum" in error
    assert "--checksum optional" in error
    found, _ = import_logs("--checksum", "optional", ins=text)
    assert_stamped_when_measured(found["ins/imu"], 5)


# -- the time of an attitude ----------------------------------------------------------------------------------


def burst(time_s, *lines_after):
    """Return the text of a burst; ``lines_after`` are pairs (seconds after ``time_s``, sentence)."""
    return "".join(
        line_received_at(time_s + after_s, text) for after_s, text in sorted(lines_after, key=lambda line: line[0])
    )


LAYOUTS = {
    "zda first": lambda t: [(0.1, zda(t)), (0.2, gga(t)), (0.35, psxn(t))],
    "zda last": lambda t: [(0.1, psxn(t)), (0.3, zda(t))],
    "zda last, with gga": lambda t: [(0.1, gga(t)), (0.2, psxn(t)), (0.3, zda(t))],
    "zda last, one datagram": lambda t: [(0.2, psxn(t)), (0.2, gga(t)), (0.2, zda(t))],
    "zda first, one datagram": lambda t: [(0.2, zda(t)), (0.2, gga(t)), (0.2, psxn(t))],
    "zda last, slow line": lambda t: [(0.05, psxn(t)), (0.25, gga(t)), (0.65, zda(t))],
    "zda first, slow line": lambda t: [(0.05, zda(t)), (0.15, gga(t)), (0.6, psxn(t))],
}


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
@pytest.mark.parametrize("role", ["ins", "reference"])
def test_an_attitude_has_the_time_of_its_own_burst(import_logs, tmp_path, layout, role):
    text = "".join(burst(time_s, *layout(time_s)) for time_s in range(20))
    if role == "ins":
        found, _ = import_logs(ins=text)
        assert_stamped_when_measured(found["ins/imu"], 20)
    else:
        (tmp_path / "second.log").write_text(text)
        found, _ = import_logs("--reference", f"second={tmp_path / 'second.log'}", ins=text)
        assert_stamped_when_measured(found["reference/second/imu"], 20)


@pytest.mark.parametrize("layout", ["zda first", "zda last", "zda last, with gga"])
def test_an_attitude_whose_own_zda_was_lost_is_not_stamped_by_another(import_logs, layout):
    lines = [LAYOUTS[layout](time_s) for time_s in range(30)]
    lines = [
        [line for line in each if number not in (7, 8, 19) or "ZDA" not in line[1]] for number, each in enumerate(lines)
    ]
    found, printed = import_logs(ins="".join(burst(time_s, *each) for time_s, each in enumerate(lines)))
    assert_stamped_when_measured(found["ins/imu"], 27)
    assert "attitude without ZDA 3; 3 of 30 attitudes have no ZDA of their own: --time receive" in printed


@pytest.mark.parametrize("zda_after_s", [-0.005, 0.005])
@pytest.mark.parametrize("first_s", [0.0, 0.4, 0.9])
def test_one_of_ten_attitudes_per_zda_has_its_time(import_logs, zda_after_s, first_s):
    """The log begins at any fraction of a second; the attitude of a whole second is next to its ZDA."""
    lines = [(time_s + 0.05, psxn(time_s)) for time_s in np.arange(300) / 10.0 + first_s]
    lines += [(time_s + 0.05 + zda_after_s, zda(time_s)) for time_s in range(31)]
    lines = [line for line in lines if line[0] >= first_s]
    found, printed = import_logs(
        ins="".join(line_received_at(*line) for line in sorted(lines, key=lambda line: line[0]))
    )
    assert_stamped_when_measured(found["ins/imu"], 30)
    assert "270 of 300 attitudes have no ZDA of their own: --time receive" in printed


@pytest.mark.parametrize("offset_s", [18.0, -18.0, 0.2, -6.0])
def test_a_clock_that_is_ahead_or_behind_is_reported(import_logs, offset_s):
    text = "".join(line_received_at(time_s, pashr(time_s + offset_s)) for time_s in range(20))
    _, printed = import_logs(ins=text)
    side = "ahead of" if offset_s > 0.0 else "behind"
    assert f"its clock is {abs(offset_s):.3g} s {side} the receive times" in printed
    assert ("(GPS time instead of UTC)" in printed) == (offset_s == 18.0)
    assert ("(leap seconds subtracted twice)" in printed) == (offset_s == -18.0)
    assert "use --time receive" in printed


@pytest.mark.parametrize(
    ("offset", "hours"),
    [("", 0), ("Z", 0), ("+00:00", 0), ("+02:00", 2), ("-0500", -5), ("+05:30", 5.5), ("+02", 2)],
)
@pytest.mark.parametrize("fraction", ["", ".5", ",500", ".500000", ".500000000"])
def test_the_utc_offset_of_a_receive_time(import_logs, offset, hours, fraction):
    times = [START + timedelta(hours=hours, seconds=time_s) for time_s in range(3)]
    text = "".join(f"{time:%Y-%m-%dT%H:%M:%S}{fraction}{offset} {psxn(0)}\n" for time in times)
    found, _ = import_logs("--time", "receive", ins=text)
    assert stamps_s(found["ins/imu"]) == [time_s + (0.5 if fraction else 0.0) for time_s in range(3)]


@pytest.mark.parametrize("odd", ["+02:00Z", ".5000000001", ".500000000x", "+2:00", "+25:00", " +02:00", "z", "-"])
def test_an_invalid_receive_time_is_rejected(import_logs, odd):
    text = line_received_at(0.0, psxn(0)) + f"2026-05-04T22:10:01{odd} {psxn(1)}\n"
    found, printed = import_logs("--time", "receive", ins=text)
    assert len(found["ins/imu"]) == 1
    assert "no receive time 1" in printed or "half line or no checksum 1" in printed or "unparsed 1" in printed


def test_tag_blocks_and_ais_in_a_log(import_logs):
    block, ais = "\\s:SN0001,c:1777932600*28\\", "!AIVDM,1,1,,B,15MgK45P3@G?fl0E`JbR0OwT0@MS,0*4E"
    lines = [(t + after_s, text) for t in range(5) for after_s, text in LAYOUTS["zda first"](t)]
    plain, _ = import_logs(ins="".join(line_received_at(*line) for line in lines))
    tagged, printed = import_logs(
        ins="".join(
            line_received_at(time_s, f"{block}{text}") + line_received_at(time_s, ais) for time_s, text in lines
        )
    )
    assert "not of interest !AIVDM 15" in printed
    for topic in ("ins/imu", "gnss/fix"):
        assert len(plain[topic]) == 5
        assert stamps_s(tagged[topic]) == stamps_s(plain[topic])


# -- positions ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("quality", "status"),
    [(0, -1), (1, 0), (2, 1), (3, 0), (4, 2), (5, 2), (6, -1), (7, -1), (8, -1), (9, -1), ("", -1), (12, -1)],
)
def test_the_quality_of_a_position(import_logs, quality, status):
    found, _ = import_logs(ins=line_received_at(0.1, gga(0, quality=quality)))
    ((_, fix),) = found["gnss/fix"]
    assert fix.status.status == status
    assert np.isnan(fix.latitude) == (status == -1)


def test_quality_nine_is_a_fix_on_request(import_logs):
    found, _ = import_logs("--quality-9-is-fix", ins=line_received_at(0.1, gga(0, quality=9)))
    assert found["gnss/fix"][0][1].status.status == 1


@pytest.mark.parametrize(
    ("position", "problem"),
    [
        ("4712.3456,,01020.5000,W", "GGA with an incomplete position"),
        ("4712.3456,N,01020.5000,", "GGA with an incomplete position"),
        ("4712.3456,E,01020.5000,N", "GGA with an incomplete position"),
        ("4712.3456,N,,", "GGA with an incomplete position"),
        ("4775.3456,N,01020.5000,W", "GGA with 60 minutes or more"),
        ("4712.3456,N,01060.0000,W", "GGA with 60 minutes or more"),
        ("9000.0001,N,01020.5000,W", "GGA beyond 90° of latitude"),
        ("4712.3456,N,18000.0001,E", "GGA beyond 90° of latitude"),
        ("-4712.3456,N,01020.5000,W", "unparsed"),
    ],
)
def test_an_invalid_position_is_rejected_with_the_reason(import_logs, position, problem):
    found, printed = import_logs(ins=line_received_at(0.1, gga(0)) + line_received_at(1.1, gga(1, position=position)))
    assert stamps_s(found["gnss/fix"]) == [0.0]
    assert problem in printed


def test_a_receiver_without_a_position_reports_no_fix(import_logs):
    found, _ = import_logs(ins=line_received_at(0.1, gga(0, position=",,,", quality=0)))
    assert found["gnss/fix"][0][1].status.status == -1


# -- several instruments in one log ---------------------------------------------------------------------------


def test_two_receivers_in_one_log_are_named_and_one_can_be_chosen(import_logs):
    """The positions of the receivers differ by a tenth of a minute of latitude, 185 m."""
    other = POSITION.replace("4712.3456", "4712.4456")
    text = "".join(
        line_received_at(t + 0.1, gga(t))
        + line_received_at(t + 0.2, gga(t, "GN", other))
        + line_received_at(t + 0.3, pashr(t))
        for t in range(9)
    )
    found, printed = import_logs(ins=text)
    assert "GGA of several talkers (GN 9, GP 9), up to 185 m apart: choose one with --talker" in printed
    found, printed = import_logs("--talker", "GN", ins=text)
    assert [message.latitude for _, message in found["gnss/fix"]] == pytest.approx(9 * [47 + 12.4456 / 60])
    assert len(found["ins/imu"]) == 9
    assert "several talkers" not in printed
    assert "talker GP 9" in printed


def test_two_compasses_that_contradict_each_other_are_named(import_logs):
    ins = "".join(line_received_at(t + 0.1, pashr(t)) for t in range(9))
    gyro = "".join(
        line_received_at(t, sentence("HEHDT,350.0,T")) + line_received_at(t + 0.4, sentence("GPHDT,175.0,T"))
        for t in range(9)
    )
    _, printed = import_logs(ins=ins, gyro=gyro)
    assert "HDT of several talkers (GP 9, HE 9), up to 175.0° apart: choose one with --talker" in printed
    found, printed = import_logs("--talker", "HE", ins=ins, gyro=gyro)
    assert len(found["reference/gyro/imu"]) == 9
    assert "several talkers" not in printed


@pytest.mark.parametrize("talker", ["gp", "GPS", "", "$G"])
def test_a_talker_is_two_capital_letters(tmp_path, capsys, talker):
    assert main(["--ins", "x", "--talker", talker, "--out", str(tmp_path / "out.mcap")]) == 2
    assert f"--talker {talker}: expected two capital letters" in capsys.readouterr().err


def test_bursts_of_random_layouts_never_get_the_time_of_another_burst(import_logs):
    """Sentences of a burst arrive in any order within 0.45 s, up to 0.3 s late; some are lost."""
    rng = np.random.default_rng(16)
    for trial in range(20):
        order, late_s = rng.permutation(3), float(rng.uniform(0.0, 0.3))
        places_s = np.sort(rng.uniform(0.02, 0.45, 3))[order] + late_s
        lines = [
            (t + float(place_s) + float(rng.uniform(0.0, 0.02)), make(t))
            for t, (make, place_s) in itertools.product(range(20), zip((zda, gga, psxn), places_s, strict=True))
            if rng.random() > 0.1
        ]
        lines.sort(key=lambda line: line[0])
        found, _ = import_logs(ins="".join(line_received_at(*line) for line in lines))
        assert len(found.get("ins/imu", [])) > 10, (trial, places_s)
        assert_stamped_when_measured(found["ins/imu"], len(found["ins/imu"]))
