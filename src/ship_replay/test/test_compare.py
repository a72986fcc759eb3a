"""Two runs side by side: differences are reported with size and time, equality as such."""

import contextlib
import math
import re
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.stamps import ns_from_stamp
from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_replay.commands.compare import main
from ship_replay.comparison.pair import differences, input_sentences, read_pair, read_published
from ship_replay.comparison.pair_page import PAIR_SECTIONS, pair_page
from ship_replay.comparison.pair_summary import pair_summary, pair_warnings
from ship_replay.comparison.pair_tables import (
    alignment_tables,
    budget_tables,
    error_rows,
    events_of_one,
    parameter_differences,
    text_differences,
)
from ship_replay.evaluation.evaluate import evaluate
from ship_replay.offline.replay import ADAPTERS, replay
from ship_testing.bag_parts import write_beginning, write_part
from ship_testing.browser import CHROMIUM, Browser
from ship_testing.hand_made_bags import START_NS, imu, innovation, ship_attitude
from ship_testing.usage_errors import usage_error
from ship_watch.suite_state import Event, Safety

BAGS = Path(__file__).parents[3] / "bags"
SECOND_NS = 1_000_000_000
LENGTH_S = 25.0
NOISE = "white_sigma_arcsec: 1.0"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("compared")


@pytest.fixture(scope="module")
def inputs(folder):
    """The first seconds of the demonstration's inputs."""
    return write_beginning(BAGS / "demo.mcap", folder / "in.mcap", LENGTH_S)


@pytest.fixture(scope="module")
def plain(folder, inputs):
    """The inputs, replayed with their own configuration."""
    replay(inputs, folder / "plain.mcap", ADAPTERS)
    return folder / "plain.mcap"


@pytest.fixture(scope="module")
def noisier(folder, inputs):
    """The inputs, replayed with a configuration in which the INS is three times as noisy."""
    with read_bag(inputs) as bag:
        text = bag.attachments["suite.yaml"].decode()
    assert text.count(NOISE) == 1
    (folder / "noisier.yaml").write_text(text.replace(NOISE, "white_sigma_arcsec: 3.0"))
    replay(inputs, folder / "noisier.mcap", ADAPTERS, folder / "noisier.yaml")
    return folder / "noisier.mcap"


@pytest.fixture(scope="module")
def pair(plain, noisier):
    return read_pair(plain, noisier)


@pytest.fixture(scope="module")
def page(pair):
    return pair_page(pair)


def sentences(pair):
    return pair_summary(pair, error_rows(pair), parameter_differences(*pair.recordings))


class TestAnotherConfiguration:
    @pytest.mark.slow
    def test_every_section_in_its_order_and_nothing_of_the_network(self, page):
        places = [page.index(f'<h2 id="{name}">{title}</h2>') for name, title in PAIR_SECTIONS]
        assert places == sorted(places)
        assert not re.search(r"https?://|<script|<link|@import|url\((?!#)", page)
        ids = re.findall(r'\bid="([^"]*)"', page)
        assert len(ids) == len(set(ids))
        assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', page)) <= set(ids)

    @pytest.mark.slow
    def test_the_same_bags_give_the_same_bytes(self, page, plain, noisier):
        assert pair_page(read_pair(plain, noisier)) == page

    @pytest.mark.slow
    def test_several_processes_give_the_same_bytes(self, page, plain, noisier, monkeypatch):
        """Long bags are read by several processes; here every bag counts as long."""
        monkeypatch.setattr("ship_replay.report.recording.SHORT_BYTES", 0)
        assert pair_page(read_pair(plain, noisier)) == page

    def test_the_parameter_and_its_line_are_named(self, pair):
        found = parameter_differences(*pair.recordings)
        assert [(one.node, one.name, one.a, one.b) for one in found] == [
            ("ship_attitude", "ins.white_sigma_arcsec", "1", "3")
        ]
        texts = text_differences(*pair.recordings)
        assert texts["scenario.yaml"] == []
        changed = [line.split() for line in texts["suite.yaml"] if re.match(r"[+-] ", line)]
        assert changed == [["-", "white_sigma_arcsec:", "1.0"], ["+", "white_sigma_arcsec:", "3.0"]]
        assert "One parameter differs: ship_attitude ins.white_sigma_arcsec 1 in A, 3 in B." in sentences(pair)

    def test_the_difference_of_the_outputs_by_hand(self, pair, plain, noisier):
        """The largest difference B minus A, its time and the RMS are computed from the messages."""
        headings = []
        for path in (plain, noisier):
            with read_bag(path) as bag:
                messages = [record.decode() for record in bag.records({"ship/attitude"})]
            headings.append({ns_from_stamp(one.header.stamp): one.heading for one in messages if one.status != 3})
        a, b = headings
        by_hand = {stamp: float(wrap_pi(b[stamp] - a[stamp])) / ARCSEC for stamp in sorted(a.keys() & b.keys())}
        (found,) = pair.differences
        assert found.orientation.topic == "ship/attitude"
        assert found.time_ns.tolist() == list(by_hand)
        worst_ns = max(by_hand, key=lambda stamp: abs(by_hand[stamp]))
        largest, stamp_ns = found.largest(0)
        assert (largest, stamp_ns) == (pytest.approx(by_hand[worst_ns]), worst_ns)
        assert abs(by_hand[worst_ns]) > 0.1
        assert found.rms_arcsec(0) == pytest.approx(math.sqrt(np.mean(np.square(list(by_hand.values())))))
        assert not any(found.channels_equal)

    def test_stated_sigmas_are_those_of_the_messages(self, pair, plain):
        with read_bag(plain) as bag:
            messages = [record.decode() for record in bag.records({"ship/attitude"})]
        variances = [one.covariance[0] for one in messages if one.status != 3]
        assert pair.differences[0].sigmas_arcsec(0)[0] == pytest.approx(math.sqrt(np.mean(variances)) / ARCSEC)

    def test_errors_are_those_of_evaluate(self, pair, plain, noisier):
        fused = [evaluate(path).errors[0] for path in (plain, noisier)]
        row = next(row for row in error_rows(pair) if row.label == "fused" and row.channel == "pitch")
        assert row.rms == tuple(one.statistics()["pitch.rms_arcsec"] for one in fused)
        assert row.ratio == row.rms[1] / row.rms[0]
        assert row.samples == tuple(len(one.time_ns) for one in fused)

    def test_three_times_the_noise_is_three_times_the_noise_in_the_budget(self, pair):
        ((_, columns, rows),) = budget_tables(pair)
        (cells,) = (cells for name, *cells in rows if name == "ins_noise")
        assert columns[1::2] == [">heading A", ">pitch A", ">roll A"]
        ratios = [float(b) / float(a) for a, b in zip(cells[::2], cells[1::2], strict=True)]
        assert ratios == pytest.approx([3.0] * 3, rel=0.1)

    def test_safe_share(self, pair):
        """The 95 % error of pitch with three times the noise is 1.96 · 3″, always over the limit of 3″."""
        assert pair.b.recording.seconds("pitch")[Safety.SAFE] == 0
        assert pair.a.recording.seconds("pitch")[Safety.SAFE] > 0
        assert any(re.match(r"A was SAFE longer in .*pitch", text) for text in sentences(pair))

    def test_the_voyage_is_the_same(self, pair):
        assert input_sentences(pair)[0].startswith("The inputs are the same simulated voyage")


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")
def test_in_a_browser(page, folder):
    """No request except for the file itself, no error, and no horizontal scrolling on a telephone."""
    (folder / "pair.html").write_text(page)
    with contextlib.closing(Browser()) as browser:
        for width, height in ((1280, 800), (390, 844)):
            browser.open((folder / "pair.html").as_uri(), width, height)
            assert browser.problems == []
            assert set(browser.addresses) == {(folder / "pair.html").as_uri()}
            assert browser.evaluate("document.documentElement.scrollWidth") <= width
            assert browser.evaluate("document.querySelectorAll('figure svg').length") == 3


class TestTheSameRecording:
    def test_the_same_file_is_reported_as_same_and_equal(self, plain):
        twice = read_pair(plain, plain)
        assert twice.is_same
        assert sentences(twice)[0] == "A and B are the same recording (same SHA-256)."
        (found,) = twice.differences
        assert found.all_equal
        assert found.channels_equal == (True, True, True)
        assert f"ship/attitude: all {len(found.time_ns)} messages are equal to the last bit." in sentences(twice)
        assert events_of_one(twice)[0] == []
        text = pair_page(twice)
        assert text.count("equal to the last bit") == 1 + 3
        assert {row["apart"] for _, rows in alignment_tables(twice) for row in rows} == {"equal"}

    def test_run_again_is_another_file_and_yet_equal(self, plain, folder):
        """The same messages, with another attachment: not the same recording, equal outputs."""
        again = write_part(plain, folder / "again.mcap", lambda record: True)
        with BagWriter(folder / "again_noted.mcap") as writer, read_bag(again) as bag:
            for name, data in bag.attachments.items():
                writer.add_attachment(name, data)
            writer.add_attachment("notes.yaml", "weather: calm\n")
            for record in bag.records():
                writer.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
        pair = read_pair(plain, folder / "again_noted.mcap")
        assert not pair.is_same
        assert pair.differences[0].all_equal
        assert "No parameter differs." in sentences(pair)
        assert "+weather: calm" in text_differences(*pair.recordings)["notes.yaml"]


def test_the_last_bit_counts(plain, folder):
    """One heading differs by one bit: the heading is not equal, all other values are."""
    with BagWriter(folder / "bit.mcap") as writer, read_bag(plain) as bag:
        for number, record in enumerate(bag.records({"ship/attitude"})):
            message = record.decode()
            if number == 200:
                message.heading = math.nextafter(message.heading, math.inf)
            writer.write("ship/attitude", message, record.log_time_ns)
    (found,) = differences(read_published(plain), read_published(folder / "bit.mcap"))
    assert found.channels_equal == (False, True, True)
    assert found.messages_equal == len(found.time_ns) - 1
    assert not found.all_equal
    # One bit of a heading of 0.6 rad, 2^-53 rad: 2.3e-11 arcsec.
    assert found.largest(0)[0] == pytest.approx(2.0**-53 / ARCSEC)


@pytest.mark.slow
def test_an_angle_in_one_run_only(plain, noisier, folder):
    """A has replayed pointings and attitudes; B has attitudes only."""
    inputs = write_beginning(BAGS / "theodolite.mcap", folder / "theodolite_in.mcap", LENGTH_S)
    replay(inputs, folder / "theodolite.mcap", ADAPTERS)
    with BagWriter(folder / "both.mcap") as writer:
        for path in (plain, folder / "theodolite.mcap"):
            with read_bag(path) as bag:
                for record in bag.records():
                    if not record.topic.startswith("truth/") or path == plain:
                        writer.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
    pair = read_pair(folder / "both.mcap", noisier)
    texts = sentences(pair)
    assert "theodolite/pointing: published in A only." in texts
    assert any(re.match(r"Elevation: published in A \(SAFE .* of the time\), not in B\.", text) for text in texts)
    assert [found.orientation.topic for found in pair.differences] == ["ship/attitude"]
    text = pair_page(pair)
    row = re.search(r"<tr[^>]*><td>azimuth</td>(.*?)</tr>", text).group(1)
    cells = re.findall(r'<td class="r">([^<]*)</td>', row)
    assert all(cell.endswith("%") for cell in cells[::2])
    assert cells[1::2] == ["–"] * 3


def test_a_sensor_out_in_one_only(plain, inputs, folder):
    """B lacks the data of the forward sensor from 8 s on: the summary names the sensor and counts its messages."""
    topic = "star/fore/horizon_attitude"
    with read_bag(inputs) as bag:
        cut_ns = bag.start_ns + 8 * SECOND_NS
    degraded = write_part(inputs, folder / "cut_in.mcap", lambda one: one.topic != topic or one.log_time_ns < cut_ns)
    replay(degraded, folder / "degraded.mcap", ADAPTERS)
    pair = read_pair(plain, folder / "degraded.mcap")
    texts = sentences(pair)
    # The bag begins at 11:50:07.8; three seconds without data of a star sensor are an outage.
    assert any(re.match(r"star.fore was out in B and not in A: 11:50:1\d to the end \(", one) for one in texts)
    assert any(re.search(rf"{topic} \d+ in A, \d+ in B", text) for text in texts)
    events, both = events_of_one(pair)
    assert any(row["side"] == "B" and "star.fore OUT" in row["text"] for row in events)
    assert both > 0


def with_outages(report_data, outages_s):
    """Return the recording with outages of star.fore: begin and end, s after the start; None is the end of the run."""
    start_ns = report_data.recording.start_utc_ns
    events = []
    for from_s, to_s in outages_s:
        events.append(Event(start_ns + from_s * SECOND_NS, "source", "star.fore", "star.fore OUT, no data"))
        if to_s is not None:
            events.append(Event(start_ns + to_s * SECOND_NS, "source", "star.fore", "star.fore IN"))
    return replace(report_data, recording=replace(report_data.recording, events=events))


@pytest.mark.parametrize(("in_a", "in_b", "expected"), [
    ([(5, 10)], [(6, 11)], ["Identical outages in both runs: star.fore."]),
    ([(5, 15)], [(8, 11)], ["star.fore was out in A and not in B: 5 to 8 (no data), 11 to 15 (no data)."]),
    ([(5, None)], [(12, None)], ["star.fore was out in A and not in B: 5 to 12 (no data)."]),
    ([(12, 14)], [(10, None)], ["star.fore was out in B and not in A: 14 to the end (no data)."]),
    ([(3, 6)], [(9, 12)], ["star.fore was out in A and not in B: 3 to 6 (no data).",
                           "star.fore was out in B and not in A: 9 to 12 (no data)."]),
    ([], [], ["No source was out in A or in B."]),
])
def test_differing_outages_of_both_runs(pair, in_a, in_b, expected):
    """Differences of two seconds or less count as the same time; times by hand."""
    changed = replace(pair, a=with_outages(pair.a, in_a), b=with_outages(pair.b, in_b))
    start_s = pair.a.recording.start_utc_ns // SECOND_NS
    texts = [text for text in sentences(changed) if re.search(r"out in|outages in", text)]
    since_start = re.compile(r"\b(\d\d):(\d\d):(\d\d)\b")

    def seconds_since_start(match):
        hour, minute, second = map(int, match.groups())
        return str(hour * 3600 + minute * 60 + second - start_s % 86400)

    assert [since_start.sub(seconds_since_start, text) for text in texts] == expected


def test_injected_faults_are_other_inputs(plain, folder):
    with BagWriter(folder / "injected.mcap") as writer, read_bag(plain) as bag:
        writer.add_metadata("injection", {"seed": "7"})
        for record in bag.records():
            writer.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
    texts = input_sentences(read_pair(plain, folder / "injected.mcap"))
    assert texts == ["The inputs are not the same: faults were injected (seed 7 in B only)."]


def test_rounding_differences_are_reported_as_such(tmp_path):
    """Runs on two machines: not equal, but without a relevant difference."""
    a = write_attitudes(tmp_path / "a.mcap", 20, offset_rad=1.0)
    b = write_attitudes(tmp_path / "b.mcap", 20, offset_rad=math.nextafter(1.0, 2.0))
    assert "the angles differ only by rounding, by less than 1e-06″." in " ".join(sentences(read_pair(a, b)))


def test_a_difference_across_north(tmp_path):
    a = write_attitudes(tmp_path / "a.mcap", 5, offset_rad=-1 * ARCSEC)
    b = write_attitudes(tmp_path / "b.mcap", 5, offset_rad=2 * ARCSEC)
    (found,) = differences(read_published(a), read_published(b))
    assert found.difference_arcsec[:, 0] == pytest.approx([3.0] * 50)


def write_attitudes(path, seconds, start_s=0, offset_rad=0.0, covariance=None, truth=True):
    """Write attitudes ten times a second, with a heading of ``offset_rad``; the true heading is zero."""
    with BagWriter(path) as bag:
        for tick in range(10 * seconds):
            stamp_ns = START_NS + start_s * SECOND_NS + tick * SECOND_NS // 10
            if truth:
                bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
            message = ship_attitude(stamp_ns, offset_rad % (2 * math.pi))
            if covariance is not None:
                message.covariance = covariance
            bag.write("ship/attitude", message, stamp_ns)
            if tick % 10 == 0:
                bag.write("ship/innovation", innovation(stamp_ns, "star.fore", [0.0] * 3, [ARCSEC] * 3, 1.0), stamp_ns)
    return path


def test_partly_at_other_times(tmp_path):
    """A lasts 40 s, B begins after 30 s and lasts 40 s: ten seconds are in common."""
    a = write_attitudes(tmp_path / "a.mcap", 40, offset_rad=2 * ARCSEC)
    b = write_attitudes(tmp_path / "b.mcap", 40, start_s=30, offset_rad=-1 * ARCSEC)
    pair = read_pair(a, b)
    assert any("The times differ" in text and "10 s in common" in text for text in input_sentences(pair))
    assert pair.differences[0].unpaired_counts == (300, 300)
    assert pair.differences[0].difference_arcsec[:, 0] == pytest.approx([-3.0] * 100)
    heading = error_rows(pair)[0]
    assert heading.rms == pytest.approx((2.0, 1.0))
    assert heading.samples == (100, 100)
    assert "B has the smaller RMS error in heading" in " ".join(sentences(pair))


def test_without_truth_innovations_stand_side_by_side(tmp_path):
    a = write_attitudes(tmp_path / "a.mcap", 20, truth=False)
    b = write_attitudes(tmp_path / "b.mcap", 20, offset_rad=ARCSEC, truth=False)
    text = pair_page(read_pair(a, b))
    assert "No truth in these recordings" in text
    assert "<svg" in text[text.index('id="errors"'):text.index('id="budget"')]
    assert "smaller RMS error" not in text
    assert "Whether the inputs are the same is unknown" in text


def test_stamps_that_never_meet(tmp_path):
    a = write_attitudes(tmp_path / "a.mcap", 20, truth=False)
    b = tmp_path / "b.mcap"
    with BagWriter(b) as bag:
        for tick in range(200):
            stamp_ns = START_NS + tick * SECOND_NS // 10 + 1
            bag.write("ship/attitude", ship_attitude(stamp_ns), stamp_ns)
            bag.write("ship/innovation", innovation(stamp_ns, "star.fore", [0.0] * 3, [ARCSEC] * 3, 1.0), stamp_ns)
    text = pair_page(read_pair(a, b))
    assert "ship/attitude: A and B have no stamp in common, so no difference is shown." in text
    assert "A and B have no output with equal stamps." in text


def test_invalid_outputs_only(tmp_path):
    """INVALID all the time, in A and in B: nothing to draw and no difference."""
    for name in "ab":
        with BagWriter(tmp_path / f"{name}.mcap") as bag:
            for tick in range(50):
                stamp_ns = START_NS + tick * SECOND_NS // 10
                bag.write("ship/attitude", ship_attitude(stamp_ns, *[math.nan] * 3, status=3), stamp_ns)
                message = innovation(stamp_ns, "star.fore", [0.0] * 3, [ARCSEC] * 3, 1.0 + (name == "b"))
                bag.write("ship/innovation", message, stamp_ns)
    pair = read_pair(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert pair.differences == []
    assert "A and B have no output with equal stamps." in pair_page(pair)


def test_events_match_by_text_and_time(pair):
    """Events two seconds apart with different numbers in their texts match; the event five seconds later is only in B.
    """
    times_and_counts = {"a": [(10, 5)], "b": [(12, 7), (15, 5)]}
    histories = {
        side: [Event(time_s * SECOND_NS, "source", "ins", f"ins OUT, {count} rejected in a row")
               for time_s, count in rows]
        for side, rows in times_and_counts.items()
    }
    changed = replace(
        pair, **{side: replace(data, recording=replace(data.recording, events=histories[side]))
                 for side, data in (("a", pair.a), ("b", pair.b))}
    )
    rows, both = events_of_one(changed)
    assert both == 1
    assert [(row["side"], row["when"]) for row in rows] == [("B", "00:00:15")]


class TestBadInput:
    def test_a_bag_without_outputs(self, tmp_path, capsys):
        a = write_attitudes(tmp_path / "a.mcap", 5)
        with BagWriter(tmp_path / "in.mcap") as writer:
            writer.write("ins/imu", imu(START_NS), START_NS)
        line = usage_error(main, capsys, a, tmp_path / "in.mcap", "--out", tmp_path / "c.html")
        expected = f"compare: {tmp_path / 'in.mcap'}: no outputs of the suite: expected topic ship/attitude or"
        assert line.startswith(expected)

    def test_a_truth_without_truth(self, tmp_path, capsys):
        a = write_attitudes(tmp_path / "a.mcap", 5, truth=False)
        line = usage_error(main, capsys, a, a, "--truth", a, "--out", tmp_path / "c.html")
        assert line.startswith(f"compare: {a}: no truth: expected topic truth/attitude or truth/pointing")

    def test_no_overlap_in_time(self, tmp_path, capsys):
        a = write_attitudes(tmp_path / "a.mcap", 5)
        b = write_attitudes(tmp_path / "b.mcap", 5, start_s=60)
        line = usage_error(main, capsys, a, b, "--out", tmp_path / "c.html")
        assert line == (
            f"compare: {b}: no time in common with {a}: outputs from 2023-11-14 22:14:20 to 2023-11-14 22:14:24 UTC, "
            "expected some from 2023-11-14 22:13:20 to 2023-11-14 22:13:24\n"
        )
        assert not (tmp_path / "c.html").exists()

    @pytest.mark.slow
    def test_the_complaint_of_another_process(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr("ship_replay.report.recording.SHORT_BYTES", 0)
        a = write_attitudes(tmp_path / "a.mcap", 5)
        with BagWriter(tmp_path / "in.mcap") as writer:
            writer.write("ins/imu", imu(START_NS), START_NS)
        line = usage_error(main, capsys, a, tmp_path / "in.mcap", "--out", tmp_path / "c.html")
        assert line.startswith(f"compare: {tmp_path / 'in.mcap'}: no outputs of the suite: expected topic")
        assert active_children() == []

    def test_no_bag(self, tmp_path, capsys):
        a = write_attitudes(tmp_path / "a.mcap", 5)
        (tmp_path / "notes.mcap").write_text("no bag at all, although it is called one")
        line = usage_error(main, capsys, a, tmp_path / "notes.mcap", "--out", tmp_path / "c.html")
        assert line.startswith(f"compare: {tmp_path / 'notes.mcap'}: ")

    def test_a_suite_file_of_another_version(self, tmp_path, capsys):
        a = write_attitudes(tmp_path / "a.mcap", 5)
        with read_bag(a) as bag, BagWriter(tmp_path / "b.mcap") as writer:
            writer.add_attachment("suite.yaml", "optical_axis:\n  ros__parameters:\n    frobnicate: 1\n")
            for record in bag.records():
                writer.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
        line = usage_error(main, capsys, a, tmp_path / "b.mcap", "--out", tmp_path / "c.html")
        assert f"{tmp_path / 'b.mcap'}: attachment suite.yaml" in line
        assert "frobnicate" in line


def test_it_is_written_and_not_written_over(tmp_path, capsys):
    a = write_attitudes(tmp_path / "a.mcap", 5)
    out = tmp_path / "c.html"
    assert main([str(a), str(a), "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"compare: {out}\n"
    assert main([str(a), str(a), "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err


class TestWarnings:
    """Warnings of a comparison state what differs, why it matters and what to do; the summary does not repeat them."""

    def test_other_times(self, tmp_path):
        a = write_attitudes(tmp_path / "a.mcap", 40, offset_rad=2 * ARCSEC)
        b = write_attitudes(tmp_path / "b.mcap", 40, start_s=30)
        pair = read_pair(a, b)
        (times,) = [one for one in pair_warnings(pair, []) if "The times differ" in one.what]
        assert times.why.startswith("Shares and means of A and B refer to different times")
        assert "at equal stamps" in times.do
        text = pair_page(pair)
        assert text.count("The times differ") == 1
        assert f"To do: {times.do}" in text

    def test_a_source_without_errors(self, tmp_path):
        pair = read_pair(write_attitudes(tmp_path / "a.mcap", 5), write_attitudes(tmp_path / "b.mcap", 5))
        problem = "A and B: star.fore not evaluated: no attitude on star/fore/horizon_attitude while the truth is known"
        found = pair_warnings(pair, [problem, "A: a warning of its own"])
        assert found[-2].why.startswith("Errors of this source are missing in the tables")
        assert "--truth BAG" in found[-2].do
        assert (found[-1].what, found[-1].why) == ("A: a warning of its own", "")

    def test_commits(self, tmp_path):
        bags = []
        for letter in "ab":
            recording = write_attitudes(tmp_path / f"{letter}.mcap", 5)
            bags.append(tmp_path / f"{letter}_out.mcap")
            with BagWriter(bags[-1]) as writer, read_bag(recording) as bag:
                writer.add_metadata("suite", {"commit": letter * 8})
                for record in bag.records():
                    writer.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
        texts = [one.what for one in pair_warnings(read_pair(*bags), [])]
        assert "A and B were made by different commits of the suite: aaaaaaaa and bbbbbbbb." in texts
