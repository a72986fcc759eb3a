"""The report: all sections, numbers of evaluate, states of the live page, reproducible bytes, no network."""

import re

import numpy as np
import pytest

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.provenance import COMMIT_RECORD, suite_commit
from ship_replay.commands.report import main
from ship_replay.evaluation.evaluate import evaluate
from ship_replay.evaluation.figures import UtcTicks
from ship_replay.report.drawings import MAX_POINTS, decimate_errors, decimation_mask, source_colours
from ship_replay.report.page import SECTIONS, page, summary
from ship_replay.report.recording import read_recording, read_report_data
from ship_replay.report.tables import duration, event_rows, number, outages
from ship_testing.hand_made_bags import PERIOD_NS, START_NS, imu, ship_attitude
from ship_testing.report_bags import SECOND_NS, copy_bag, section, write_bag
from ship_testing.usage_errors import usage_error
from ship_watch.suite_state import Event, Safety


@pytest.fixture(scope="module")
def recording_path(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("run") / "out.mcap", gap_s=(20, 25), rejected=range(30, 37))


def test_negative_numbers_have_a_minus_sign_of_any_size():
    assert [number(value) for value in (-0.5, -999.4, -1234.0, 1234.0)] == ["−0.5", "−999", "−1234", "1234"]


def test_every_section_in_its_order_and_nothing_of_the_network(recording_path):
    text = page(read_report_data(recording_path))
    places = [text.index(f'<h2 id="{name}">{title}</h2>') for name, title in SECTIONS]
    assert places == sorted(places)
    assert not re.search(r"https?://|<script|<link|@import|url\((?!#)", text)
    assert all(target.startswith("#") for target in re.findall(r'(?:src|href)="([^"]*)"', text))
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    # The ids to which drawings refer exist in the page.
    assert set(re.findall(r'(?:xlink:href="#|url\(#)([^")]+)', text)) <= set(ids)


def test_the_same_bag_gives_the_same_bytes(recording_path):
    assert page(read_report_data(recording_path)) == page(read_report_data(recording_path))


def test_numbers_are_those_of_evaluate(recording_path):
    text = page(read_report_data(recording_path))
    fused = evaluate(recording_path).errors[0].statistics()
    row = re.search(r"<tr><td>fused</td><td>heading</td>(.*?)</tr>", text).group(1)
    shown = re.findall(r'<td class="r">([^<]*)</td>', row)[:4]
    assert shown == [number(fused[f"heading.{name}"]) for name in
                     ("rms_arcsec", "bias_arcsec", "sigma_arcsec", "rms_over_sigma")]
    assert shown[0] == "1"  # the heading error of the bag is 1″


def test_states_follow_the_limits(recording_path):
    """The 95 % errors of heading 7.8″, pitch 3.9″ and roll 5.9″ are over the limits 5″, 3″ and 3″: CAUTION.

    Without data the state is UNSAFE.
    """
    recording = read_recording(recording_path)
    seconds = recording.seconds("heading")
    assert seconds[Safety.SAFE] == 0
    assert seconds[Safety.CAUTION] >= 25
    assert recording.last is not None
    changes = [event.text for event in recording.events if event.kind == "state" and event.subject == "heading"]
    assert any("CAUTION → UNSAFE" in text for text in changes)
    assert any("UNSAFE → CAUTION" in text for text in changes)


def test_no_state_without_output(recording_path):
    seconds = {second for second, _ in read_recording(recording_path).safety_states["heading"]}
    start_s = START_NS // SECOND_NS
    # The limit of age is 1 s: from 22 s on the last value is old, until the next value at 25 s.
    assert not seconds & {start_s + 22, start_s + 23, start_s + 24}
    assert {start_s + 18, start_s + 27} <= seconds


def test_rejections_are_counted_with_their_times(recording_path):
    rejections = [one for one in read_recording(recording_path).rejections if one.by == "filter"]
    assert {one.source for one in rejections} == {"star.fore"}
    assert [one.utc_ns for one in rejections] == [START_NS + second * SECOND_NS for second in range(30, 37)]


def test_a_source_rejected_five_times_is_in_summary_and_alerts(recording_path):
    data = read_report_data(recording_path)
    out = [event for event in data.recording.events if event.subject == "star.fore" and "OUT" in event.text]
    assert abs(out[0].utc_ns - (START_NS + 34 * SECOND_NS)) <= 2 * SECOND_NS // 10
    assert summary(data.recording)[1].startswith("Worst source: star.fore, out once, ")
    assert "star.fore: clean the sensor and check its mounting" in summary(data.recording)[4]
    assert "<td>star.fore</td>" in section(page(data), "verdict")
    assert not data.recording.alerts_are_recorded
    assert "star.fore.out" in {one.alert.id for one in data.recording.alerts}


def test_an_outage_whose_reason_changes_is_one(recording_path):
    recording = read_recording(recording_path)
    first = START_NS + 10 * SECOND_NS
    texts = [("star.fore OUT, 5 rejected in a row", 0), ("star.fore OUT, no data", 1), ("star.fore IN", 5),
            ("ins OUT, no data", 7)]
    recording.events = [Event(first + after * SECOND_NS, "source", text.split()[0], text) for text, after in texts]
    found = outages(recording)
    assert [(one.source, one.from_ns - first, one.to_ns and one.to_ns - first, one.why) for one in found] == [
        ("star.fore", 0, 5 * SECOND_NS, "5 rejected in a row"), ("ins", 7 * SECOND_NS, 0, "no data")
    ]
    assert found[1].text.endswith(" to the end (no data)")


def test_without_truth_innovations_take_the_room(tmp_path):
    text = page(read_report_data(write_bag(tmp_path / "out.mcap", with_truth=False)))
    assert "No truth in this recording" in text
    assert '<svg' in text[text.index('id="errors"'):text.index('id="budget"')]


def test_truth_of_another_bag(tmp_path):
    out = write_bag(tmp_path / "out.mcap", with_truth=False)
    truth = write_bag(tmp_path / "truth.mcap")
    assert read_report_data(out, truth).evaluation.errors[0].label == "fused"


class TestBadInput:
    def test_a_bag_without_outputs(self, tmp_path, capsys):
        bag = tmp_path / "in.mcap"
        with BagWriter(bag) as writer:
            writer.write("ins/imu", imu(START_NS), START_NS + PERIOD_NS)
        line = usage_error(main, capsys, bag, "--out", tmp_path / "a.html")
        assert line.startswith(f"report: {bag}: no outputs of the suite: expected topic ship/attitude or")

    @pytest.mark.parametrize("short_bytes", [0, 8_000_000])
    def test_outputs_without_anything_to_compare(self, short_bytes, tmp_path, capsys, monkeypatch):
        """The error of the evaluating process is reported, with and without a separate process."""
        monkeypatch.setattr("ship_replay.report.recording.SHORT_BYTES", short_bytes)
        bag = tmp_path / "out.mcap"
        with BagWriter(bag) as writer:
            writer.write("ship/attitude", ship_attitude(START_NS), START_NS)
        line = usage_error(main, capsys, bag, "--out", tmp_path / "a.html")
        assert line.startswith(f"report: {bag}: nothing to evaluate: expected topics")

    def test_a_truth_without_truth(self, tmp_path, capsys):
        out = write_bag(tmp_path / "out.mcap", 5, with_truth=False)
        line = usage_error(main, capsys, out, "--truth", out, "--out", tmp_path / "a.html")
        assert line.startswith(f"report: {out}: no truth: expected topic truth/attitude or truth/pointing")

    def test_no_bag(self, tmp_path, capsys):
        bag = tmp_path / "notes.mcap"
        bag.write_text("no bag at all, although it is called one")
        assert usage_error(main, capsys, bag, "--out", tmp_path / "a.html").startswith(f"report: {bag}: ")

    def test_an_unknown_key_in_the_limits(self, tmp_path, capsys):
        limits = tmp_path / "limits.yaml"
        limits.write_text("heading_arcsec: 8.0\nheadding_arcsec: 8.0\n")
        out = write_bag(tmp_path / "out.mcap", 5)
        line = usage_error(main, capsys, out, "--limits", limits, "--out", tmp_path / "a.html")
        assert f"{limits}:2" in line
        assert "headding_arcsec" in line


def test_limits_of_the_ship_change_the_states(tmp_path, recording_path):
    limits = tmp_path / "limits.yaml"
    limits.write_text("heading_arcsec: 2.0\n")
    assert main([str(recording_path), "--limits", str(limits), "--out", str(tmp_path / "a.html")]) == 0
    assert re.search(r"<td>heading</td>.*2″</td>", (tmp_path / "a.html").read_text())


def test_missing_accuracy_is_no_obstacle(tmp_path):
    with BagWriter(tmp_path / "out.mcap") as bag:
        for second in range(5):
            stamp_ns = START_NS + second * SECOND_NS
            bag.write("ship/attitude", ship_attitude(stamp_ns), stamp_ns)
            bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
    assert 'id="status"' in page(read_report_data(tmp_path / "out.mcap"))


def test_thinned_lines_keep_their_extremes():
    rng = np.random.default_rng(1)
    values = rng.normal(size=(50_000, 2))
    values[31_234, 0], values[7, 1] = 40.0, -50.0
    values[100:300] = np.nan
    kept = decimation_mask(values, MAX_POINTS)
    assert kept.sum() <= MAX_POINTS
    assert kept[31_234]
    assert kept[7]
    assert np.isfinite(values[kept]).all()


def test_thinned_errors_keep_the_largest(recording_path):
    errors = evaluate(recording_path).errors[0]
    assert np.nanmax(np.abs(decimate_errors(errors).error_arcsec)) == np.abs(errors.error_arcsec).max()


@pytest.mark.parametrize(("seconds", "text"), [(3.0, "3 s"), (65.2, "1 min 05 s"), (3720.0, "1 h 02 min")])
def test_durations(seconds, text):
    assert duration(seconds) == text


def events(*entries):
    """Return events from seconds, kinds and texts; the first word of a text is the subject."""
    return [Event(START_NS + second * SECOND_NS, kind, text.split()[0], text) for second, kind, text in entries]


class TestFiveSentences:
    def test_each_opens_the_page_in_its_order(self, recording_path):
        data = read_report_data(recording_path)
        sentences = summary(data.recording)
        assert [text.partition(":")[0] for text in sentences] == [
            "Availability", "Worst source", "Cause → consequence", "Mountings", "To do"
        ]
        shown = re.findall(r"<p>(.*?)</p>", section(page(data), "verdict").partition("<table>")[0])
        assert len(shown) == 5

    def test_availability_counts_missing_outputs(self, recording_path):
        """The run of 40 s has no data from 20 s to 25 s; the first second without data is within the age limit."""
        share = re.search(r"ship/attitude VALID ([\d.]+) % of the time", summary(read_recording(recording_path))[0])
        assert float(share[1]) == pytest.approx(90.0, abs=1.0)

    def test_the_cause_precedes_its_consequences(self, recording_path):
        recording = read_recording(recording_path)
        recording.events = events(
            (5, "source", "star.fore OUT, needs ins"), (5, "source", "ins OUT, no data"),
            (5, "state", "heading SAFE → UNSAFE, no data from ins"),
            (9, "source", "ins IN"), (9, "source", "star.fore IN"),
        )
        sentences = summary(recording)
        assert sentences[1].startswith("Worst source: ins, out once, 4 s in all (10 % of the time)")
        assert re.fullmatch(
            r"Cause → consequence: ins out at \S+ \(no data\) → heading not SAFE, star.fore not usable.", sentences[2]
        )

    def test_a_shifted_mounting_is_named(self, recording_path):
        recording = read_recording(recording_path)
        recording.events = events(
            (5, "source", "star.fore OUT, excluded"), (30, "source", "star.fore IN"),
            (31, "source", "star.fore reinstated, mounting shifted by 51″"),
        )
        assert summary(recording)[3].startswith("Mountings: star.fore reinstated, mounting shifted by 51″ at ")

    def test_a_run_without_faults_has_nothing_to_do(self, tmp_path):
        sentences = summary(read_recording(write_bag(tmp_path / "out.mcap")))
        assert sentences[1] == "Worst source: none; no source was out."


class TestEvents:
    def test_changes_back_and_forth_are_one_row(self):
        flapping = [(8 * number + 3 * (number % 2), "state",
                     f"roll {'CAUTION → SAFE' if number % 2 else 'SAFE → CAUTION, over the limit'}")
                    for number in range(8)]
        other = [(4, "state", "pitch SAFE → CAUTION, over the limit"), (90, "source", "ins OUT, no data")]
        rows = event_rows(events(*sorted(flapping + other)))
        assert [row.text for row in rows] == [
            "roll SAFE ↔ CAUTION (over the limit), 4 times, longest CAUTION 11 s",
            "pitch SAFE → CAUTION, over the limit", "ins OUT, no data",
        ]
        assert sum(row.count for row in rows) == 10
        assert "–" in rows[0].when

    def test_changes_with_minutes_between_them_have_their_own_rows(self):
        changes = [(100 * number, "source", f"ins {'IN' if number % 2 else 'OUT, no data'}") for number in range(8)]
        assert len(event_rows(events(*changes))) == 8

    def test_each_time_leads_to_its_line_in_the_figure(self, recording_path):
        text = page(read_report_data(recording_path))
        targets = re.findall(r'href="#(status-mark-\d+)"', section(text, "events"))
        assert targets
        assert {*targets} <= {*re.findall(r'id="([^"]*)"', section(text, "status"))}


def test_no_line_through_a_gap(recording_path):
    """No data from 20 s to 25 s."""
    errors = decimate_errors(evaluate(recording_path).errors[0])
    empty = np.isnan(errors.error_arcsec).all(axis=1)
    (second,) = (errors.time_ns[empty] - START_NS) / SECOND_NS
    assert 20.0 <= second < 25.0


@pytest.mark.parametrize(
    ("length_s", "step_s"),
    [(8, 2), (95, 20), (120, 20), (700, 120), (7000, 1200), (400_000, 86400)],
)
def test_ticks_are_at_round_times(length_s, step_s):
    start_ns = START_NS + 123_456_789
    places = np.array(UtcTicks(start_ns, 8).tick_values(0.0, float(length_s)))
    assert np.allclose((places + start_ns / SECOND_NS) % step_s % step_s, 0.0, atol=1e-5) or np.allclose(
        (places + start_ns / SECOND_NS) % step_s, step_s, atol=1e-5)
    assert np.allclose(np.diff(places), step_s)


def test_a_source_has_one_colour_in_all_figures(recording_path):
    data = read_report_data(recording_path)
    colours = source_colours(data.recording, data.evaluation)
    assert len({*colours.values()}) == len(colours) == 2
    text = page(data)
    assert colours["star.fore"] in section(text, "refusals")
    assert colours["fused"] in section(text, "errors")


def test_the_commit_of_the_suite_is_stated_of_a_plain_bag(tmp_path):
    """The report states the commit of the suite that wrote the bag, and the commit that made the report."""
    with BagWriter(tmp_path / "out.mcap") as writer:
        writer.add_metadata(COMMIT_RECORD, {"commit": "0123abcd"})
        copy_bag(write_bag(tmp_path / "night.mcap", 5), writer)
    text = section(page(read_report_data(tmp_path / "out.mcap")), "provenance")
    made_bag, made_report = text.split("Versions that made this report")
    assert "<tr><td>suite, commit</td><td>0123abcd</td></tr>" in made_bag
    assert f"<td>{suite_commit() or 'unknown: no git checkout'}</td>" in made_report
