"""The report of various bags: in a namespace, in a folder, with alerts, of a star node alone, truncated."""

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
from ship_replay.commands.report import main
from ship_replay.report.page import page
from ship_replay.report.recording import read_report_data
from ship_replay.report.tables import utc
from ship_testing.hand_made_bags import FACTORY, START_NS, ship_attitude, star_message
from ship_testing.report_bags import SECOND_NS, SIGMA_ENU, copy_bag, section, write_bag
from ship_watch.alerts.alerts import AlertState
from ship_watch.suite_state import Priority


@pytest.fixture(scope="module")
def recording_path(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("run") / "out.mcap", gap_s=(20, 25), rejected=range(30, 37))


@pytest.mark.slow
@pytest.mark.parametrize("namespace", ["vessel", "ship"])
def test_a_recording_in_a_namespace(recording_path, tmp_path, namespace):
    copy_bag(recording_path, BagWriter(tmp_path / "recorded.mcap"), f"/{namespace}/")
    out = tmp_path / "a.html"
    assert main([str(tmp_path / "recorded.mcap"), "--namespace", f"/{namespace}", "--out", str(out)]) == 0
    text = out.read_text()
    for name in ("verdict", "errors", "consistency", "events", "refusals"):
        assert section(text, name) == section(page(read_report_data(recording_path)), name)


@pytest.mark.slow
def test_a_rosbag2_folder_of_several_files(recording_path, tmp_path):
    folder = tmp_path / "night"
    copy_bag(recording_path, FolderWriter(folder, SplitLimits(size_bytes=10_000)))
    text = page(read_report_data(folder))
    alone = page(read_report_data(recording_path))
    for name in ("verdict", "errors", "consistency", "events", "refusals"):
        assert section(text, name) == section(alone, name)
    parts = sorted(folder.glob("*.mcap"))
    assert len(parts) > 1
    for part in parts:
        assert f"{hashlib.sha256(part.read_bytes()).hexdigest()}  {part.name}" in section(text, "provenance")


def test_the_hash_of_a_file_is_that_of_sha256sum(recording_path):
    whole = hashlib.sha256(recording_path.read_bytes()).hexdigest()
    assert f">{whole}</td>" in section(page(read_report_data(recording_path)), "provenance")


def alert(state, second, text="no data from star.fore"):
    stamp = make_header(FACTORY, START_NS + second * SECOND_NS, "").stamp
    return FACTORY.make(
        "ship_msgs/msg/Alert", id="star.fore.out", instance=1, priority=int(Priority.WARNING), state=int(state),
        source="star.fore", text=text, value=math.nan, limit=math.nan, unit="",
        raised=make_header(FACTORY, START_NS + 10 * SECOND_NS, "").stamp, changed=stamp,
    )


def test_recorded_alerts_replace_computed_ones(recording_path, tmp_path):
    """Recorded alerts have the texts and times of the alert node, and acknowledgements, which cannot be computed."""
    path = tmp_path / "out.mcap"
    history = [(10, AlertState.ACTIVE_UNACKNOWLEDGED), (14, AlertState.ACTIVE_ACKNOWLEDGED), (20, None)]
    with BagWriter(path) as writer, read_bag(recording_path) as bag:
        records = [(record.log_time_ns, record) for record in bag.records()]
        states = [(START_NS + second * SECOND_NS, (state, second)) for second, state in history]
        for time_ns, what in sorted(records + states, key=lambda entry: entry[0]):
            if isinstance(what, tuple):
                header = make_header(FACTORY, time_ns, "")
                alerts = [] if what[0] is None else [alert(*what)]
                message = FACTORY.make("ship_msgs/msg/AlertArray", header=header, alerts=alerts)
                writer.write("ship/alerts", message, time_ns)
            else:
                writer.write_raw(what.topic, what.type_name, what.data, time_ns)
    reported = read_report_data(path)
    assert [(one.what, one.alert.id) for one in reported.recording.alerts] == [
        ("active unacknowledged", "star.fore.out"), ("active acknowledged", "star.fore.out"), ("over", "star.fore.out")
    ]
    assert [one.utc_ns for one in reported.recording.alerts[:2]] == [
        START_NS + second * SECOND_NS for second in (10, 14)
    ]
    assert reported.recording.alerts[2].utc_ns == pytest.approx(START_NS + 20 * SECOND_NS, abs=SECOND_NS // 5)
    shown = section(page(reported), "alerts")
    assert "As recorded from ship/alerts." in shown
    assert "WARNING" in shown


def test_outputs_of_one_node_alone(tmp_path):
    """A bag that contains only solutions of star sensors has errors, but no angle to show."""
    with BagWriter(tmp_path / "out.mcap") as bag:
        bag.add_attachment("suite.yaml", "star_attitude:\n  ros__parameters: {}\n")
        for tick in range(50):
            stamp_ns = START_NS + tick * SECOND_NS // 5
            bag.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
            message = star_message(stamp_ns, np.eye(3), SIGMA_ENU @ SIGMA_ENU, "joint")
            bag.write("star/joint/solution", message, stamp_ns)
    text = page(read_report_data(tmp_path / "out.mcap"))
    assert "no attitude and no pointing was published" in section(text, "verdict")
    assert "<td>star.joint</td>" in section(text, "errors")


def test_versions_of_the_bag_and_of_the_report_are_separate(recording_path, tmp_path):
    shown = section(page(read_report_data(recording_path)), "provenance")
    assert "The bag does not contain the commit or the versions of the suite that made it." in shown
    assert shown.count("<h3>") == 1
    path = tmp_path / "box.mcap"
    writer = BagWriter(path)
    stated = {"suite": {"ship_node": "0.0.7"}, "python": "3.9.2", "machine": "riscv64", "libraries": {"numpy": "1.2.3"}}
    writer.add_attachment("versions.json", json.dumps(stated))
    copy_bag(recording_path, writer)
    made, _, here = section(page(read_report_data(path)), "provenance").partition("Versions that made this report")
    rows = [("ship_node", "0.0.7"), ("numpy", "1.2.3"), ("python", "3.9.2"), ("machine", "riscv64")]
    for name, version in rows:
        assert f"<td>{name}</td><td>{version}</td>" in made
        assert f"<td>{version}</td>" not in here
    assert f"<td>numpy</td><td>{np.__version__}</td>" in here


@pytest.mark.parametrize("damaged", [b"not JSON", b"[]", b'{"suite": 3}'])
def test_damaged_versions_are_none(recording_path, tmp_path, damaged):
    writer = BagWriter(tmp_path / "box.mcap")
    writer.add_attachment("versions.json", damaged)
    copy_bag(recording_path, writer)
    assert "The bag does not contain the commit" in section(page(read_report_data(tmp_path / "box.mcap")), "provenance")


@pytest.mark.parametrize(("left", "end_s"), [(0.97, 40.0), (0.5, 30.0)])
def test_a_truncated_bag_is_reported_up_to_its_end(tmp_path, capsys, left, end_s):
    """A truncated recording is reported with a warning and the time of its end."""
    whole = tmp_path / "whole.mcap"
    copy_bag(write_bag(tmp_path / "night.mcap"), writer := BagWriter(whole))
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


