"""The report: all sections, numbers of evaluate, words of the watch, the same bytes, no word of the network."""

import hashlib
import html
import json
import math
import re

import numpy as np
import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.stamps import make_header
from ship_estimation.refusals import Reason
from ship_geometry.rotations import ARCSEC
from ship_replay.commands.report import main
from ship_replay.evaluation.evaluate import evaluate
from ship_replay.report.drawings import MOST_POINTS, thin_errors, thinned
from ship_replay.report.night import read_night
from ship_replay.report.page import SECTIONS, page
from ship_replay.report.tables import outages
from ship_replay.report.told import read_told
from ship_replay.report.wording import duration, number, utc
from ship_testing.hand_made_bags import FACTORY, PERIOD_NS, START_NS, imu, innovation, ship_attitude, star_message
from ship_testing.refusals import refused
from ship_watch.alert_states import AlertState
from ship_watch.picture import Event, Priority, Safety

SECOND_NS = 1_000_000_000
SIGMA_ENU = np.diag([2.0, 3.0, 4.0]) * ARCSEC
"""Of a ship that heads North: pitch 2″, roll 3″, heading 4″, so that 95 % are 3.9″, 5.9″ and 7.8″."""


def write_night(path, seconds=40, with_truth=True, silent=(0, 0), refused=()):
    """Attitudes ten times a second, 1″ off in heading, silent between two seconds; refusals of star.fore at seconds."""
    with BagWriter(path) as bag:
        bag.add_attachment("suite.yaml", "ship_attitude:\n  ros__parameters: {}\n")
        for tick in range(10 * seconds):
            stamp_ns = START_NS + tick * SECOND_NS // 10
            if with_truth:
                bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
            if not silent[0] <= tick / 10 < silent[1]:
                estimate = ship_attitude(stamp_ns, ARCSEC, covariance_enu=SIGMA_ENU @ SIGMA_ENU)
                # Of (heading, pitch, roll), for a level ship that heads North.
                estimate.covariance = (np.diag([4.0, 2.0, 3.0]) ** 2 * ARCSEC**2).ravel()
                bag.write("ship/attitude", estimate, stamp_ns)
            if tick % 10 == 0:
                accepted = tick // 10 not in refused
                reason = 0 if accepted else int(Reason.GATE)
                told = innovation(stamp_ns, "star.fore", [ARCSEC, 0.0, 0.0], [ARCSEC] * 3, 1.0, accepted, reason)
                bag.write("ship/innovation", told, stamp_ns)
    return path


@pytest.fixture(scope="module")
def night_path(tmp_path_factory):
    return write_night(tmp_path_factory.mktemp("night") / "out.mcap", silent=(20, 25), refused=range(30, 37))


def test_every_section_in_its_order_and_nothing_of_the_network(night_path):
    text = page(read_told(night_path))
    places = [text.index(f'<h2 id="{name}">{title}</h2>') for name, title in SECTIONS]
    assert places == sorted(places)
    assert not re.search(r"https?://|<script|<link|@import|url\((?!#)", text)
    assert all(target.startswith("#") for target in re.findall(r'(?:src|href)="([^"]*)"', text))
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    # What drawings refer to is there, under the name that it has in the page.
    assert set(re.findall(r'(?:xlink:href="#|url\(#)([^")]+)', text)) <= set(ids)


def test_the_same_bag_gives_the_same_bytes(night_path):
    assert page(read_told(night_path)) == page(read_told(night_path))


def test_numbers_are_those_of_evaluate(night_path):
    text = page(read_told(night_path))
    fused = evaluate(night_path).errors[0].statistics()
    row = re.search(r"<tr><td>fused</td><td>heading</td>(.*?)</tr>", text).group(1)
    shown = re.findall(r'<td class="r">([^<]*)</td>', row)[:4]
    assert shown == [number(fused[f"heading.{name}"]) for name in
                     ("rms_arcsec", "bias_arcsec", "sigma_arcsec", "rms_over_sigma")]
    assert shown[0] == "1"  # 1″ was put in


def test_words_are_those_of_the_limits(night_path):
    """95 % heading 7.8″ over 5″, pitch 3.9″ over 3″, roll 5.9″ over 3″: CAUTION; UNSAFE while nothing comes."""
    night = read_night(night_path)
    seconds = night.seconds("heading")
    assert seconds[Safety.SAFE] == 0
    assert seconds[Safety.CAUTION] >= 25
    assert night.last is not None
    changes = [event.text for event in night.events if event.kind == "state" and event.subject == "heading"]
    assert any("CAUTION → UNSAFE" in text for text in changes)
    assert any("UNSAFE → CAUTION" in text for text in changes)


def test_no_second_is_told_while_the_output_is_silent(night_path):
    told = {second for second, _ in read_night(night_path).words["heading"]}
    start_s = START_NS // SECOND_NS
    # The limit of age is 1 s: from 22 s on the last value is old, until one comes at 25 s.
    assert not told & {start_s + 22, start_s + 23, start_s + 24}
    assert {start_s + 18, start_s + 27} <= told


def test_refusals_are_counted_with_their_times(night_path):
    refusals = [one for one in read_night(night_path).refusals if one.by == "filter"]
    assert {one.source for one in refusals} == {"star.fore"}
    assert [one.utc_ns for one in refusals] == [START_NS + second * SECOND_NS for second in range(30, 37)]


def test_a_source_refused_five_times_in_a_row_is_in_the_verdict_and_an_alert(night_path):
    told = read_told(night_path)
    out = [event for event in told.night.events if event.subject == "star.fore" and "OUT" in event.text]
    assert abs(out[0].utc_ns - (START_NS + 34 * SECOND_NS)) <= 2 * SECOND_NS // 10
    assert "star.fore was out from" in page(told)
    assert not told.night.alerts_are_recorded
    assert "star.fore.out" in {one.alert.id for one in told.night.alerts}


def test_an_outage_whose_reason_changes_is_one(night_path):
    night = read_night(night_path)
    first = START_NS + 10 * SECOND_NS
    told = [("star.fore OUT, 5 refused in a row", 0), ("star.fore OUT, silent", 1), ("star.fore IN", 5),
            ("ins OUT, silent", 7)]
    night.events = [Event(first + after * SECOND_NS, "source", text.split()[0], text) for text, after in told]
    assert [(one.source, one.from_ns - first, one.to_ns and one.to_ns - first, one.why) for one in outages(night)] == [
        ("star.fore", 0, 5 * SECOND_NS, "5 refused in a row"), ("ins", 7 * SECOND_NS, 0, "silent")
    ]
    assert outages(night)[1].text.endswith(" to the end (silent)")


def test_without_truth_innovations_take_the_room(tmp_path):
    text = page(read_told(write_night(tmp_path / "out.mcap", with_truth=False)))
    assert "There is no truth in this recording" in text
    assert '<svg' in text[text.index('id="errors"'):text.index('id="budget"')]


def test_truth_of_another_bag(tmp_path):
    out = write_night(tmp_path / "out.mcap", with_truth=False)
    truth = write_night(tmp_path / "truth.mcap")
    assert read_told(out, truth).evaluation.errors[0].label == "fused"


class TestBadInput:
    def test_a_bag_without_outputs(self, tmp_path, capsys):
        bag = tmp_path / "in.mcap"
        with BagWriter(bag) as writer:
            writer.write("ins/imu", imu(START_NS), START_NS + PERIOD_NS)
        line = refused(main, capsys, bag, "--out", tmp_path / "a.html")
        assert line.startswith(f"report: {bag}: no outputs of the suite: expected topic ship/attitude or")

    @pytest.mark.parametrize("short_bytes", [0, 8_000_000])
    def test_outputs_that_nothing_can_be_held_against(self, short_bytes, tmp_path, capsys, monkeypatch):
        """The complaint of the process that evaluates reaches the person, and so it does without one."""
        monkeypatch.setattr("ship_replay.report.told.SHORT_BYTES", short_bytes)
        bag = tmp_path / "out.mcap"
        with BagWriter(bag) as writer:
            writer.write("ship/attitude", ship_attitude(START_NS), START_NS)
        line = refused(main, capsys, bag, "--out", tmp_path / "a.html")
        assert line.startswith(f"report: {bag}: nothing to evaluate: expected topics")

    def test_a_truth_without_truth(self, tmp_path, capsys):
        out = write_night(tmp_path / "out.mcap", 5, with_truth=False)
        line = refused(main, capsys, out, "--truth", out, "--out", tmp_path / "a.html")
        assert line.startswith(f"report: {out}: no truth: expected topic truth/attitude or truth/pointing")

    def test_no_bag(self, tmp_path, capsys):
        bag = tmp_path / "notes.mcap"
        bag.write_text("no bag at all, although it is called one")
        assert refused(main, capsys, bag, "--out", tmp_path / "a.html").startswith(f"report: {bag}: ")

    def test_an_unknown_key_in_the_limits(self, tmp_path, capsys):
        limits = tmp_path / "limits.yaml"
        limits.write_text("heading_arcsec: 8.0\nheadding_arcsec: 8.0\n")
        out = write_night(tmp_path / "out.mcap", 5)
        line = refused(main, capsys, out, "--limits", limits, "--out", tmp_path / "a.html")
        assert f"{limits}:2" in line
        assert "headding_arcsec" in line


def copied(source, writer, prefix=""):
    """The messages and attachments of a bag, in a bag or folder that is open for writing; its topics get a prefix."""
    with read_bag(source) as bag:
        for name, data in bag.attachments.items():
            writer.add_attachment(name, data)
        for number, record in enumerate(bag.records()):
            writer.write_raw(prefix + record.topic, record.type_name, record.data, record.log_time_ns)
            if number % 100 == 0:
                writer.flush()
    writer.close()


def section(text, name):
    """The part of a page from one heading to the next."""
    return text[text.index(f'<h2 id="{name}"'):].partition("</h2>")[2].partition("<h2 ")[0]


@pytest.mark.parametrize("namespace", ["vessel", "ship"])
def test_a_recording_in_a_namespace(night_path, tmp_path, namespace):
    copied(night_path, BagWriter(tmp_path / "recorded.mcap"), f"/{namespace}/")
    out = tmp_path / "a.html"
    assert main([str(tmp_path / "recorded.mcap"), "--namespace", f"/{namespace}", "--out", str(out)]) == 0
    told = out.read_text()
    for name in ("verdict", "errors", "consistency", "events", "refusals"):
        assert section(told, name) == section(page(read_told(night_path)), name)


def test_a_rosbag2_folder_of_several_files(night_path, tmp_path):
    folder = tmp_path / "night"
    copied(night_path, FolderWriter(folder, SplitLimits(size_bytes=10_000)))
    told = page(read_told(folder))
    alone = page(read_told(night_path))
    for name in ("verdict", "errors", "consistency", "events", "refusals"):
        assert section(told, name) == section(alone, name)
    parts = sorted(folder.glob("*.mcap"))
    assert len(parts) > 1
    for part in parts:
        assert f"{hashlib.sha256(part.read_bytes()).hexdigest()}  {part.name}" in section(told, "provenance")


def test_the_hash_of_a_file_is_that_of_sha256sum(night_path):
    whole = hashlib.sha256(night_path.read_bytes()).hexdigest()
    assert f">{whole}</td>" in section(page(read_told(night_path)), "provenance")


def alert(state, second, text="star.fore out: silent"):
    stamp = make_header(FACTORY, START_NS + second * SECOND_NS, "").stamp
    return FACTORY.make(
        "ship_msgs/msg/Alert", id="star.fore.out", instance=1, priority=int(Priority.WARNING), state=int(state),
        source="star.fore", text=text, value=math.nan, limit=math.nan, unit="",
        raised=make_header(FACTORY, START_NS + 10 * SECOND_NS, "").stamp, changed=stamp,
    )


def test_alerts_that_were_recorded_stand_before_those_computed(night_path, tmp_path):
    """With the words and times of the alert node, and with what a person did, which nobody can compute."""
    path = tmp_path / "out.mcap"
    course = [(10, AlertState.ACTIVE_UNACKNOWLEDGED), (14, AlertState.ACTIVE_ACKNOWLEDGED), (20, None)]
    with BagWriter(path) as writer, read_bag(night_path) as bag:
        records = [(record.log_time_ns, record) for record in bag.records()]
        told = [(START_NS + second * SECOND_NS, (state, second)) for second, state in course]
        for time_ns, what in sorted(records + told, key=lambda entry: entry[0]):
            if isinstance(what, tuple):
                header = make_header(FACTORY, time_ns, "")
                alerts = [] if what[0] is None else [alert(*what)]
                message = FACTORY.make("ship_msgs/msg/AlertArray", header=header, alerts=alerts)
                writer.write("ship/alerts", message, time_ns)
            else:
                writer.write_raw(what.topic, what.type_name, what.data, time_ns)
    reported = read_told(path)
    assert [(one.what, one.alert.id) for one in reported.night.alerts] == [
        ("active unacknowledged", "star.fore.out"), ("active acknowledged", "star.fore.out"), ("over", "star.fore.out")
    ]
    assert [one.utc_ns for one in reported.night.alerts[:2]] == [START_NS + second * SECOND_NS for second in (10, 14)]
    assert reported.night.alerts[2].utc_ns == pytest.approx(START_NS + 20 * SECOND_NS, abs=SECOND_NS // 5)
    shown = section(page(reported), "alerts")
    assert "As recorded from ship/alerts." in shown
    assert "WARNING" in shown


def test_outputs_of_one_node_alone(tmp_path):
    """A bag with nothing but solutions of star sensors has no angle to show, and errors all the same."""
    with BagWriter(tmp_path / "out.mcap") as bag:
        bag.add_attachment("suite.yaml", "star_attitude:\n  ros__parameters: {}\n")
        for tick in range(50):
            stamp_ns = START_NS + tick * SECOND_NS // 5
            bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
            told = star_message(stamp_ns, np.eye(3), SIGMA_ENU @ SIGMA_ENU, "joint")
            bag.write("star/joint/solution", told, stamp_ns)
    text = page(read_told(tmp_path / "out.mcap"))
    assert "No angle was ever told." in section(text, "verdict")
    assert "<td>star.joint</td>" in section(text, "errors")


def test_versions_of_the_bag_and_of_the_report_are_told_apart(night_path, tmp_path):
    shown = section(page(read_told(night_path)), "provenance")
    assert "The bag does not say which versions of the suite made it." in shown
    assert shown.count("<h3>") == 1
    path = tmp_path / "box.mcap"
    writer = BagWriter(path)
    told = {"suite": {"ship_node": "0.0.7"}, "python": "3.9.2", "machine": "riscv64", "libraries": {"numpy": "1.2.3"}}
    writer.add_attachment("versions.json", json.dumps(told))
    copied(night_path, writer)
    made, _, here = section(page(read_told(path)), "provenance").partition("Versions that made this report")
    rows = [("ship_node", "0.0.7"), ("numpy", "1.2.3"), ("python", "3.9.2"), ("machine", "riscv64")]
    for name, version in rows:
        assert f"<td>{name}</td><td>{version}</td>" in made
        assert f"<td>{version}</td>" not in here
    assert f"<td>numpy</td><td>{np.__version__}</td>" in here


@pytest.mark.parametrize("damaged", [b"not JSON", b"[]", b'{"suite": 3}'])
def test_damaged_versions_are_none(night_path, tmp_path, damaged):
    writer = BagWriter(tmp_path / "box.mcap")
    writer.add_attachment("versions.json", damaged)
    copied(night_path, writer)
    assert "The bag does not say" in section(page(read_told(tmp_path / "box.mcap")), "provenance")


@pytest.mark.parametrize(("left", "end_s"), [(0.97, 40.0), (0.5, 30.0)])
def test_a_truncated_bag_is_told_as_far_as_it_goes(tmp_path, capsys, left, end_s):
    """A night whose recorder died is worth a report; its first lines say that it is not whole, and where it ends."""
    whole = tmp_path / "whole.mcap"
    copied(write_night(tmp_path / "night.mcap"), writer := BagWriter(whole))
    assert writer.message_count > 800
    out = tmp_path / "out.mcap"
    out.write_bytes(whole.read_bytes()[: round(left * whole.stat().st_size)])
    with read_bag(out) as bag:
        last_ns = max(record.log_time_ns for record in bag.records())
        problems = bag.problems
    assert 5.0 < (last_ns - START_NS) / SECOND_NS < end_s
    assert main([str(out), "--out", str(tmp_path / "a.html")]) == 0
    assert "warning: " in capsys.readouterr().out
    head = (tmp_path / "a.html").read_text().partition("<nav>")[0]
    assert f"to {utc(last_ns)} UTC" in head
    (warning,) = re.findall(r'<p class="warn">(.*?)</p>', head)
    assert html.unescape(warning) == problems[0]
    assert utc(last_ns) in warning


def test_limits_of_the_ship_change_the_words(tmp_path, night_path):
    limits = tmp_path / "limits.yaml"
    limits.write_text("heading_arcsec: 2.0\n")
    assert main([str(night_path), "--limits", str(limits), "--out", str(tmp_path / "a.html")]) == 0
    assert re.search(r"<td>heading</td>.*2″</td>", (tmp_path / "a.html").read_text())


def test_accuracy_that_was_never_told_is_no_obstacle(tmp_path):
    with BagWriter(tmp_path / "out.mcap") as bag:
        for second in range(5):
            stamp_ns = START_NS + second * SECOND_NS
            bag.write("ship/attitude", ship_attitude(stamp_ns), stamp_ns)
            bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
    assert 'id="status"' in page(read_told(tmp_path / "out.mcap"))


def test_thinned_lines_keep_their_extremes():
    rng = np.random.default_rng(1)
    values = rng.normal(size=(50_000, 2))
    values[31_234, 0], values[7, 1] = 40.0, -50.0
    values[100:300] = np.nan
    kept = thinned(values, MOST_POINTS)
    assert kept.sum() <= MOST_POINTS
    assert kept[31_234]
    assert kept[7]
    assert np.isfinite(values[kept]).all()


def test_thinned_errors_keep_the_largest(night_path):
    errors = evaluate(night_path).errors[0]
    assert np.abs(thin_errors(errors).error_arcsec).max() == np.abs(errors.error_arcsec).max()


@pytest.mark.parametrize(("seconds", "text"), [(3.0, "3 s"), (65.2, "1 min 05 s"), (3720.0, "1 h 02 min")])
def test_durations(seconds, text):
    assert duration(seconds) == text
