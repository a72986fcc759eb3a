"""Bytes → lines → sentences: chunks are joined, half lines are reported, and memory is bounded."""

import random

import pytest

from ship_bags.nmea.instrument_lines import BINARY, INCOMPLETE, LONGEST_LINE, NOISE, TOO_LONG, parse_line
from ship_bags.nmea.sentences import BAD_CHECKSUM, OUT_OF_RANGE, UNKNOWN, UNPARSED, VOID, NotOfInterest, Sentence
from ship_nmea.connections import LineSplitter
from ship_testing.ship_logs import sentence

# Lines of the log of R/V Nathaniel B. Palmer, 2014-08-01, see test_import_nmea.
HDT, PSXN23 = b"$HEHDT,218.53,T*12", b"$PSXN,23,0.35,-1.74,218.26,0.58*13"


def outcomes(line):
    """Return kind, name or reason of each text in a line."""
    found = [line_part.result for line_part in parse_line(line)]
    return [
        result.kind if isinstance(result, Sentence) else result.name if isinstance(result, NotOfInterest)
        else result.detail or result.reason for result in found
    ]  # fmt: skip


@pytest.mark.parametrize("end", [b"\r\n", b"\n", b"\r"])
def test_lines_in_chunks_of_any_size(end):
    lines = [HDT, PSXN23, b"$PSXN,20,1,0,0,0*3A"] * 20
    stream, rng = end.join(lines) + end, random.Random(1)
    splitter, found = LineSplitter(), []
    while stream:
        size = rng.randint(1, 50)
        found += splitter.split(stream[:size])
        stream = stream[size:]
    assert found == lines
    assert splitter.flush() == []


def test_line_without_end_is_returned_by_flush():
    splitter = LineSplitter()
    assert splitter.split(HDT) == []
    assert splitter.flush() == [HDT]
    assert splitter.flush() == []


@pytest.mark.parametrize("size", [LONGEST_LINE + 1, 100_000])
def test_line_without_end_is_returned_once_and_not_kept(size):
    splitter = LineSplitter()
    found = splitter.split(b"x" * size)
    for _ in range(1000):
        found += splitter.split(b"x" * 10_000)
    found += splitter.split(b"x\r\n" + HDT + b"\r\n")
    assert [len(line) for line in found] == [LONGEST_LINE + 1, len(HDT)]
    assert outcomes(found[0]) == [TOO_LONG]
    assert splitter.split(b"a" * LONGEST_LINE + b"\n") == [b"a" * LONGEST_LINE]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (HDT, ["HDT"]),
        (HDT + b"  ", ["HDT"]),
        (PSXN23, ["PSXN23"]),
        (b"$GPHDT,21", [INCOMPLETE]),  # which pynmea2 alone takes for a heading of 21 degrees
        (b"$HEHDT,218.53,T*1", [INCOMPLETE]),
        (b"8.53,T*12", [INCOMPLETE]),
        (b"HEHDT,218.53,T*12", [INCOMPLETE]),
        (b"$GPHDT,21" + HDT, [INCOMPLETE, "HDT"]),
        (b"18.53,T*12" + HDT, [INCOMPLETE, "HDT"]),
        (HDT + HDT, ["HDT", "HDT"]),
        (b"$HEHDT,218.54,T*12", [BAD_CHECKSUM]),
        (sentence("HEHDT,,T").encode(), [VOID]),
        (sentence("HEXYZ,1").encode(), [UNKNOWN]),
        (sentence("HEHDT,999.99,T").encode(), [OUT_OF_RANGE]),
        (sentence("HEHDT,360.0,T").encode(), ["HDT"]),
        (sentence("PSXN,23,0.1,90.01,1.0,0.0").encode(), [OUT_OF_RANGE]),
        (sentence("PSXN,23,-180.0,-90.0,0.0,0.0").encode(), ["PSXN23"]),
        (b"$GPVTG,211.32,T,235.99,M,9.4,N,17.4,K*7F", [BAD_CHECKSUM]),
        (b"$INVTG,215.11,T,239.79,M,9.1,N,16.9,K,A*05", ["INVTG"]),
        (b"!AIVDM,1,1,,A,14eG;o@034o8sd<L9i:a;WF>062D,0*7D", ["!AIVDM"]),
        (b"SUS,A,325,009.31,M,+344.00,+020.63,60,03", ["SUS"]),
        (b"hello", [UNPARSED]),
        (b"$HEHDT,218\xff53,T*12", [NOISE]),
        (bytes(range(14, 32)), [NOISE]),
        (b"x" * (LONGEST_LINE + 1), [TOO_LONG]),
        # IEC 61162-450: a datagram's mark, and a TAG block with the sender's name.
        (b"UdPbC\x00\\s:HE0001,n:12*2A\\" + HDT, ["HDT"]),
        (b"\\s:HE0001*7C\\" + HDT, ["HDT"]),
    ],
)
def test_content_of_lines(line, expected):
    assert outcomes(line) == expected


UBX = b"\xb5b\x01\x07\x08\x00" + bytes(range(0x20, 0x28)) + b"\x8a\x3f"
RTCM = b"\xd3\x02\xbc" + bytes(number % 251 for number in range(700)) + b"\x47\xea\x4b"
"""UBX contains a ``$``; RTCM is longer than a line may be, and contains line ends."""


@pytest.mark.parametrize("binary", [UBX, RTCM, RTCM.translate(None, b"\r\n"), RTCM.translate(None, b"\r\n$")])
@pytest.mark.parametrize("size", [7, 100, 10_000])
def test_no_sentence_is_lost_after_binary_messages(binary, size):
    """A receiver sends UBX or RTCM on the same line, in chunks of any size."""
    stream, splitter, found = 5 * (binary + HDT + b"\r\n" + PSXN23 + b"\r\n"), LineSplitter(), []
    for at in range(0, len(stream), size):
        found += [name for line in splitter.split(stream[at : at + size]) for name in outcomes(line)]
    assert [name for name in found if name in ("HDT", "PSXN23")] == 5 * ["HDT", "PSXN23"]
    assert set(found) <= {"HDT", "PSXN23", BINARY, NOISE, TOO_LONG, INCOMPLETE}


def test_binary_before_a_sentence_is_not_rejected():
    assert outcomes(UBX + HDT) == [BINARY, BINARY, "HDT"]
    assert outcomes(UBX) == [BINARY, NOISE]


def test_noise_never_raises():
    rng = random.Random(2)
    for _ in range(20_000):
        line = bytearray(rng.choice([HDT, PSXN23, b"\\s:x*00\\" + HDT, b"$WIXDR,C,23.3,C,0,P,,B*00"]))
        for _ in range(rng.randint(0, 4)):
            line[rng.randrange(len(line))] = rng.choice(b"$*,\\!\x00\xff059ABCPSXN")
        assert all(parsed.talker == "" or len(parsed.talker) == 2 for parsed in parse_line(bytes(line)))
