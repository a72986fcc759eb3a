"""Sentences that are cut by the end of a datagram."""

import pytest

from ship_nmea.instruments.links import JOIN_TIMEOUT_NS, DatagramLines
from ship_testing.ship_logs import sentence

ONE, OTHER = "10.0.0.7:4001", "10.0.0.9:4001"
HDT, ROT = sentence("HEHDT,218.53,T").encode(), sentence("HEROT,3.5,A").encode()


def lines_of(*datagrams):
    """Return the lines of datagrams, each (data, sender, ms), and the incomplete lines at the end."""
    lines, found = DatagramLines(), []
    for data, sender, ms in datagrams:
        found += lines.split(data, sender, ms, ms * 1_000_000)
    return found, lines.split(b"", "", 10**6, 10**15)


@pytest.mark.parametrize("at", range(1, len(HDT) + 1))
def test_sentence_over_two_datagrams_is_joined(at):
    """The second sentence is cut at any place; a datagram of another sender arrives between its parts."""
    data = ROT + b"\r\n" + HDT + b"\r\n"
    cut = len(ROT) + 2 + at
    found, late = lines_of((data[:cut], ONE, 0), (HDT + b"\r\n", OTHER, 50), (data[cut:], ONE, 190))
    assert sorted((line, sender) for _, line, sender in found) == [(HDT, ONE), (HDT, OTHER), (ROT, ONE)]
    assert late == []


def test_sentence_is_not_joined_after_200_ms():
    found, late = lines_of((HDT[:10], ONE, 0), (HDT[10:] + b"\r\n", ONE, 201))
    assert [line for _, line, _ in found] == [HDT[:10], HDT[10:]]
    found, late = lines_of((HDT[:10], ONE, 7))
    assert (found, late) == ([], [(7, HDT[:10], ONE)])
    assert JOIN_TIMEOUT_NS == 200_000_000


def test_whole_sentence_without_line_end_is_not_delayed():
    for data in (HDT, b"MET,1,2,3,4,5,6", b"\xb5b\x01\x07", HDT + b" "):
        found, late = lines_of((data, ONE, 0), (data, ONE, 1))
        assert [line.strip() for _, line, _ in found] == 2 * [data.strip()]
        assert late == []


def test_incomplete_sentences_are_bounded():
    lines = DatagramLines()
    found = [lines.split(HDT[:10], f"10.0.0.7:{port}", 0, 0) for port in range(1000)]
    assert sum(map(len, found)) == 900
    assert len(lines.split(b"", "", 0, 10**9)) == 100
