"""A source without ROS: its status follows from its messages, memory is bounded, drops of the system are counted."""

import random
import socket
from datetime import datetime, timedelta, timezone

import pytest

from ship_bags.message_store import RosbagsFactory
from ship_bags.nmea.instrument_lines import datetime_ns, parse_line
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_estimation.parameters.schema import build
from ship_nmea.instruments.config import NmeaInConfig
from ship_nmea.instruments.links import UdpLink
from ship_nmea.instruments.source import NO_TIME, Source
from ship_node.messages.common_messages import Level
from ship_testing.nmea_in_peer import free_port
from ship_testing.ship_logs import sentence

START = datetime(2026, 3, 1, 12, tzinfo=timezone.utc)


@pytest.fixture
def source():
    def make(**parameters):
        config = build(NmeaInConfig, {"sources": {"a": {"kind": "udp", "port": 10110, **parameters}}})
        return Source("a", config.sources["a"], config.role("a"), RosbagsFactory(), now_ns=0)

    return make


def pashr(utc):
    return sentence(f"PASHR,{utc:%H%M%S.%f},90.0,T,+1.0,+2.0,,0.1,0.1,0.1,1,1").encode()


def published_topics(source, line, arrival_ns, now_ns=0, *sender):
    return [topic for parsed in parse_line(line) for topic, _ in source.convert(parsed, arrival_ns, now_ns, *sender)]


def test_backward_jump_of_node_time_resets_the_instrument(source):
    """A bag is played in a loop: without a reset, attitudes of the second pass would be rejected as not later."""
    ins = source(becomes="ins")
    for _ in range(2):
        for seconds in range(3):
            utc = START + timedelta(seconds=seconds)
            assert published_topics(ins, pashr(utc), datetime_ns(utc)) == ["ins/imu"]


def test_no_line_is_used_without_node_time(source):
    ins = source(becomes="ins", silent_after_s=1.0)
    assert published_topics(ins, pashr(START), 0, 2 * NS_PER_S) == []
    status = ins.status("", 0, 2 * NS_PER_S)
    assert (status.level, status.values[f"rejected: {NO_TIME}"]) == (Level.ERROR, "1")


def test_corrected_clock_is_used_again(source):
    """The instrument's clock is 30 s ahead for 10 s, then right: attitudes are rejected for 4 s, not for 30 s."""
    ins, given = source(becomes="ins"), []
    for second in range(20):
        arrival = START + timedelta(seconds=second)
        stated = arrival + timedelta(seconds=30 if second < 10 else 0)
        fix = sentence(f"INGGA,{stated:%H%M%S}.00,2200.110899,S,01756.359432,W,1,12,0.7,-2.76,M,4.67,M,,").encode()
        assert published_topics(ins, fix, datetime_ns(arrival), second * NS_PER_S) == ["gnss/fix"]
        given += [second for _ in published_topics(ins, pashr(stated), datetime_ns(arrival), second * NS_PER_S)]
        if second == 9:
            status = ins.status("", 0, second * NS_PER_S)
            assert status.level == Level.WARN
            assert status.message.startswith("its clock is 30 s ahead of this computer's: set the clocks")
    assert given == [*range(10), *range(14, 20)]
    assert ins.status("", 0, 30 * NS_PER_S - 1).level == Level.ERROR  # no data again
    assert "ahead" not in ins.status("", 0, 30 * NS_PER_S - 1).message


def zda(utc):
    return sentence(f"GPZDA,{utc:%H%M%S}.00,{utc:%d,%m,%Y},,").encode()


@pytest.mark.parametrize("zda_first", [True, False])
def test_attitude_has_the_time_of_the_zda_of_its_burst(source, zda_first):
    ins, stamps = source(becomes="ins"), []
    for second in range(10):
        utc = START + timedelta(seconds=second)
        lines = [zda(utc), sentence("PSXN,23,1.0,2.0,90.0,0.20").encode()]
        for place, line in enumerate(lines if zda_first else reversed(lines)):
            arrival_ns = datetime_ns(utc) + (place + 1) * NS_PER_S // 10
            for parsed in parse_line(line):
                stamps += [ns_from_stamp(message.header.stamp) for _, message in ins.convert(parsed, arrival_ns, 0)]
    assert stamps == [datetime_ns(START) + second * NS_PER_S for second in range(10)]


def test_clock_behind_is_reported(source):
    """An instrument that subtracts the leap seconds from GPS time twice is 18 s behind."""
    ins = source(becomes="ins")
    published_topics(ins, pashr(START - timedelta(seconds=18)), datetime_ns(START))
    status = ins.status("", 0, 0)
    assert (status.level, status.message.partition(":")[0]) == (
        Level.WARN,
        "its clock is 18 s behind this computer's (leap seconds subtracted twice)",
    )
    published_topics(ins, pashr(START + timedelta(seconds=20)), datetime_ns(START) + 20 * NS_PER_S, 20 * NS_PER_S)
    assert ins.status("", 0, 20 * NS_PER_S).level == Level.OK


def test_two_compasses_on_one_line_are_reported(source):
    gyro = source(becomes="gyro", silent_after_s=100.0)
    for second in range(30):
        arrival_ns = datetime_ns(START) + second * NS_PER_S
        for talker, heading_deg in (("HE", 350.0), ("GP", 170.5)):
            if talker == "HE" or second < 5:
                published_topics(gyro, sentence(f"{talker}HDT,{heading_deg},T").encode(), arrival_ns, second * NS_PER_S)
        if second == 4:
            status = gyro.status("", 0, second * NS_PER_S)
            expected = "HDT of several talkers (GP 5, HE 5), up to 179.5° apart: choose one with talkers"
            assert (status.level, status.message) == (Level.WARN, expected)
    assert gyro.status("", 0, 30 * NS_PER_S).level == Level.OK


def test_frozen_clock_gives_one_attitude(source):
    ins = source(becomes="ins")
    given = [
        published_topics(ins, pashr(START), datetime_ns(START) + second * NS_PER_S, second * NS_PER_S)
        for second in range(9)
    ]
    assert given == [["ins/imu"], *8 * [[]]]
    assert ins.status("", 0, 8 * NS_PER_S).level == Level.ERROR


def test_unaligned_instrument_is_not_used(source):
    ins = source(becomes="ins")
    for fields, topics in (("0,0", []), ("0.0,0", []), ("0,1", ["ins/imu"])):
        text = sentence(f"PASHR,120000.000,90.0,T,+1.0,+2.0,,0.1,0.1,0.1,{fields}").encode()
        assert published_topics(ins, text, datetime_ns(START)) == topics


def test_heave_is_in_the_status(source):
    ins = source(becomes="ins")
    assert "heave_m" not in ins.status("", 0, 0).values
    published_topics(
        ins, sentence("PASHR,120000.000,90.0,T,+1.0,+2.0,-0.37,0.1,0.1,0.1,1,1").encode(), datetime_ns(START)
    )
    assert ins.status("", 0, 0).values["heave_m"] == "-0.37"


def test_ths_takes_precedence_over_hdt(source):
    """HDT is used before the first THS, and again more than 3 s after the last THS of any mode."""
    gyro = source(becomes="gyro")
    hdt, used = "HDT,10.0,T", []
    bodies = {
        0: hdt,
        1: "THS,1.0,A",
        2: hdt,
        3: "THS,1.0,V",
        4: "THS,,V",
        6: hdt,
        7: hdt,
        8: hdt,
        9: "THS,1,A",
        10: hdt,
    }
    for second, body in bodies.items():
        if published_topics(gyro, sentence(f"HE{body}").encode(), datetime_ns(START) + second * NS_PER_S):
            used.append(second)
    assert used == [0, 1, 8, 9]
    assert gyro.status("", 0, 0).values["rejected: THS not in mode A"] == "2"


@pytest.mark.parametrize(
    ("bodies", "reason"),
    [
        (["HEVTG,,T,,M,,N,,K,A"], "lines arrive, but no reference/a/imu for 2 s: received: HEVTG"),
        (["GPHDT,10.0,T"], "received: no usable sentences, of other talkers GP"),
        (["HEHDT,,T"], "no values in it 1, as '$HEHDT,,T*"),
        ([], "udp 0.0.0.0:10110: no line for 2 s"),
    ],
)
def test_source_without_messages_is_reported_with_the_reason(source, bodies, reason):
    gyro = source(becomes="gyro", silent_after_s=1.0, talkers=["HE"])
    for body in bodies:
        published_topics(gyro, sentence(body).encode(), datetime_ns(START), 2 * NS_PER_S)
    status = gyro.status("", 0, 2 * NS_PER_S)
    assert status.level == Level.ERROR
    assert reason in status.message


def test_past_fault_is_a_warning_for_ten_seconds(source):
    gyro = source(becomes="gyro", silent_after_s=100.0)
    published_topics(gyro, b"$HEHDT,10", datetime_ns(START), NS_PER_S)
    published_topics(gyro, sentence("HEHDT,10.0,T").encode(), datetime_ns(START), 2 * NS_PER_S)
    assert [gyro.status("", 0, now_s * NS_PER_S).level for now_s in (2, 11, 12)] == [Level.WARN, Level.WARN, Level.OK]
    assert gyro.status("Connection refused", 0, 12 * NS_PER_S).level == Level.ERROR
    levels = [gyro.status("", 5, now_s * NS_PER_S).level for now_s in (13, 23, 24)]
    assert levels == [Level.ERROR, Level.ERROR, Level.OK]


def test_counters_are_bounded(source):
    """Ten thousand names of sentences and talkers, each once."""
    gyro, rng = source(becomes="gyro", talkers=["HE"]), random.Random(3)
    for _ in range(10_000):
        talker = "".join(rng.choices("ABCDEFGHIJKLM0123456789", k=2))
        maker = "".join(rng.choices("ABCDEFGHIJKLMNOPQRSTUVWXYZ", k=3))
        for body in (f"{talker}HDT,10.0,T", f"P{maker}{'x' * 100},1", f"{talker}{maker},1"):
            published_topics(gyro, sentence(body).encode(), datetime_ns(START))
        published_topics(gyro, f"{maker}LONG,1".encode(), datetime_ns(START))
    values = gyro.status("", 0, 0).values
    assert int(values["lines"]) == 40_000
    assert len(values) < 150
    assert max(len(text) for pair in values.items() for text in pair) < 120


TEMPLATES = [
    ("ins", "INZDA,120000.00,01,03,2026,,"), ("ins", "PSXN,20,1,0,0,0"), ("ins", "PSXN,23,0.35,-1.74,218.26,0.58"),
    ("ins", "PASHR,120000.000,90.0,T,+1.0,+2.0,,0.1,0.1,0.1,1,1"), ("gyro", "HEROT,3.5,A"),
    ("ins", "PRDID,1.0,2.0,90.0"), ("ins", "PTNTHPR,90.0,N,1.0,N,2.0,N"), ("ins", "PSAT,HPR,120000.00,9.0,1.0,2.0,N"),
    ("gnss", "INGGA,120000.00,2200.110899,S,01756.359432,W,1,12,0.7,-2.76,M,4.67,M,,"),
    ("gyro", "HETHS,218.53,A"), ("gyro", "HEHDT,218.53,T"), ("weather", "WIXDR,C,23.3,C,0,H,50.1,P,0,P,1009.5,H,0"),
    ("weather", "WIMDA,30.2269,I,1.0236,B,17.7,C,,,43.3,,5.0,C,131.5,T,128.6,M,0.8,N,0.4,M"),
]  # fmt: skip
ODD = ["", "nan", "inf", "-1e400", "1e30", "x", "sNaN", "99", "235960.00", "250000", "-", "1,2", "0x10", "²", "1_0"]


def test_odd_fields_never_raise(source):
    """Sentences with right checksums and odd fields: an instrument's software has faults as well."""
    rng, sources = random.Random(4), {role: source(becomes=role) for role, _ in TEMPLATES}
    given = 0
    for number in range(6000):
        role, body = rng.choice(TEMPLATES)
        name, *fields = body.split(",")
        for _ in range(rng.randint(0, 2)):
            fields[rng.randrange(len(fields))] = rng.choice(ODD)
        line = sentence(",".join([name, *fields])).encode(errors="replace")
        for parsed in parse_line(line):
            for topic, message in sources[role].convert(parsed, datetime_ns(START) + number, 0):
                given += 1
                if topic.endswith("imu"):
                    q = message.orientation
                    assert abs(q.x**2 + q.y**2 + q.z**2 + q.w**2 - 1.0) < 1e-9
    assert given > 1000


def test_datagrams_dropped_by_the_system_are_counted():
    """Linux buffers a limited number of bytes for a socket; ten thousand datagrams arrive before the link reads."""
    port, count = free_port(), 10_000
    link = UdpLink("127.0.0.1", port, "")
    link.open()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(count):
            sender.sendto(b"$HEHDT,10.0,T*2D\r\n", ("127.0.0.1", port))
        read = sum(1 for _ in iter(link.read, (b"", "")))
        # The system reports the number of dropped datagrams with the next datagram.
        sender.sendto(b"$HEHDT,10.0,T*2D\r\n", ("127.0.0.1", port))
        assert link.read()[0]
    assert link.dropped_count > 0
    assert read + link.dropped_count == count
    link.close()
