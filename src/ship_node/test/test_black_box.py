"""Black box without a live node: order, names, a slow disk, a full disk, attachments."""

import json
import resource
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import NonSeekingReader
from std_msgs.msg import String

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.mcap.mcap_writer import CHUNK_BYTES
from ship_bags.message_factory import RosidlFactory
from ship_bags.provenance import SUITE_PACKAGES
from ship_estimation.parameters.schema import build
from ship_node.black_box import black_box as black_box_module
from ship_node.black_box.black_box import MAX_ENTRIES_BEFORE_TIME, BlackBox, free_path
from ship_node.black_box.black_box_format import (
    EVENTS_TOPIC,
    FORMAT,
    METADATA,
    VERSIONS_ATTACHMENT,
    ChangeRefused,
    ClockJumpedBack,
    ClockStepped,
    Closed,
    DuplicatePublishersChanged,
    EntriesLost,
    Event,
    FileUsed,
    ParametersChanged,
    ServiceCalled,
    Tick,
    event_from_text,
    event_text,
)
from ship_node.live.adapter_calls import AdapterCalls
from ship_node.messages.common_messages import Level
from ship_node.parameters.parameter_file import load_config, parameter_text
from ship_node.saved_files.saved_document import RecordingFiles
from ship_testing.black_box_entries import SECOND_NS, read_entries
from ship_testing.relay_adapter import RelayAdapter, RelayConfig

CONFIG = build(RelayConfig, {"sensors": {"fore": {"elevation_deg": 45}}})
EVENTS: list[Event] = [
    Tick(),
    ClockJumpedBack(),
    ClockStepped(-300_000_000_123),
    DuplicatePublishersChanged("ins/imu", "two publishers send on ins/imu: /a and /b; stop all but one"),
    ParametersChanged({"gate.probability": 0.1 + 0.2, "offsets_s": [1e-300, 2.0]}, None),
    ParametersChanged({"gate.count": 13}, "not wanted"),
    ChangeRefused({"gate.probability": 1.5, "frame_id": "ins"}, "out of range"),
    ServiceCalled("reset", True, "done"),
    ServiceCalled("explode", None, None),
    FileUsed("/a/b.yaml", True, "files/0001/b.yaml", None),
    FileUsed("/a/b.yaml", False, None, 2),
    EntriesLost(7),
    Closed(),
]


def new_black_box(path: Path | str, failures: list[str] | None = None, part_bytes: int = 0) -> BlackBox:
    adapter = RelayAdapter(CONFIG, RosidlFactory())
    reports = [] if failures is None else failures
    return BlackBox(str(path), adapter, CONFIG, adapter.outputs, "/ship", reports.append, part_bytes)


@pytest.mark.parametrize("event", EVENTS, ids=lambda event: type(event).__name__)
def test_event_text_round_trip(event: Event) -> None:
    assert event_from_text(event_text(event)) == event


@pytest.mark.parametrize("text", ["", "7", "[]", "{}", '{"event": "dance"}', '{"event": "tick", "x": 1}', "{no json"])
def test_invalid_event_text_is_bad_input(text: str) -> None:
    with pytest.raises(BadInput, match="is not an event of a black box"):
        event_from_text(text)


def test_order_of_use_is_kept_when_the_clock_goes_back(tmp_path: Path) -> None:
    black_box = new_black_box(tmp_path / "box.mcap")
    black_box.add("ins/imu", b"first", 20 * SECOND_NS)
    black_box.add("ship/attitude", b"its result", 20 * SECOND_NS)
    black_box.add_event(ClockJumpedBack(), 5 * SECOND_NS)
    black_box.add("ins/imu", b"second", 5 * SECOND_NS)
    black_box.close()
    assert read_entries(tmp_path / "box.mcap") == [
        ("ins/imu", b"first", 20 * SECOND_NS),
        ("ship/attitude", b"its result", 20 * SECOND_NS),
        (EVENTS_TOPIC, ClockJumpedBack(), 5 * SECOND_NS),
        ("ins/imu", b"second", 5 * SECOND_NS),
        (EVENTS_TOPIC, Closed(), 5 * SECOND_NS),
    ]


def test_order_of_use_with_an_oversized_message_and_a_clock_jump_back(tmp_path: Path) -> None:
    """Between two flushes the order of use is that of the file, independent of the chunks."""
    black_box = new_black_box(tmp_path / "box.mcap")
    given = []
    for number, time_s in enumerate([20, 20, 25, 3, 3, 25, 4000, 2]):
        data = bytes([number]) * (2 * CHUNK_BYTES if number in (1, 4) else 20)
        black_box.add("ins/imu", data, time_s * SECOND_NS)
        given.append(("ins/imu", data, time_s * SECOND_NS))
    black_box.close()
    assert read_entries(tmp_path / "box.mcap")[:-1] == given


def test_entries_before_the_first_time_get_the_first_time(tmp_path: Path) -> None:
    black_box = new_black_box(tmp_path / "box.mcap")
    black_box.add_event(ParametersChanged({"gate.count": 4}, None), 0)
    black_box.add_event(Tick(), 7 * SECOND_NS)
    black_box.close()
    assert [ns for _, _, ns in read_entries(tmp_path / "box.mcap")] == [7 * SECOND_NS] * 3


def test_parameters_versions_and_identity_are_attached(tmp_path: Path) -> None:
    new_black_box(tmp_path / "box.mcap").close()
    with (tmp_path / "box.mcap").open("rb") as stream:
        attachments = {a.name: a.data.decode() for a in NonSeekingReader(stream).iter_attachments()}
    with (tmp_path / "box.mcap").open("rb") as stream:
        metadata = {m.name: m.metadata for m in NonSeekingReader(stream).iter_metadata()}
    of_black_box = metadata[METADATA]
    assert len(of_black_box.pop("box")) == 16
    assert of_black_box == {"format": FORMAT, "node": "relay", "namespace": "/ship", "part": "1", "first": "box.mcap"}
    assert load_config(RelayConfig, attachments[SUITE_ATTACHMENT], "relay") == CONFIG
    found = json.loads(attachments[VERSIONS_ATTACHMENT])
    assert found["suite"].keys() == {*SUITE_PACKAGES, "ship_testing"}
    assert found["message_definitions"]["ship_msgs/msg/ShipAttitude"].startswith("RIHS01_")


@pytest.mark.parametrize("frame_id", ["", "1e3", "yes", "~", "a: b # c", "Bö 'x' \"y\"", "two\nlines", "0x10"])
def test_parameter_file_round_trip(frame_id: str) -> None:
    config = build(
        RelayConfig,
        {
            "frame_id": frame_id,
            "offsets_s": [0.1 + 0.2, -1e-300, 5e-324],
            "gate": {"bias_deg": 1e16},
            "sensors": {"yes": {"elevation_deg": -0.0}, "fore": {"elevation_deg": 1 / 3}},
        },
    )
    assert load_config(RelayConfig, parameter_text("relay", config), "relay") == config


def test_an_existing_black_box_is_never_overwritten(tmp_path: Path) -> None:
    for expected in ("box.mcap", "box_2.mcap", "box_3.mcap"):
        black_box = new_black_box(tmp_path / "box.mcap")
        assert black_box.path.name == expected
        black_box.close()
    (tmp_path / "box.mcap").unlink()
    (tmp_path / "box_2.mcap").unlink()
    assert free_path(tmp_path / "box.mcap").name == "box_4.mcap"


def test_black_box_in_a_folder_has_the_node_name(tmp_path: Path) -> None:
    for folder in (f"{tmp_path}", f"{tmp_path}/new/"):
        black_box = new_black_box(folder)
        assert black_box.path == Path(folder) / "relay.mcap"
        black_box.close()


@pytest.mark.parametrize("name", ["box.bag", "file/box.mcap", "box"])
def test_unusable_path_is_bad_input(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BadInput, match=r"parameter 'black_box' = '.*'"):
        new_black_box(tmp_path / name)


def test_entries_lost_by_a_slow_disk_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(black_box_module, "MAX_QUEUE_ENTRIES", 3)
    monkeypatch.setattr(black_box_module, "FLUSH_PERIOD_S", 60.0)
    black_box = new_black_box(tmp_path / "box.mcap")
    for number in range(10):
        black_box.add("ins/imu", bytes([number]), SECOND_NS + number)
    assert black_box.status().level == Level.ERROR
    assert black_box.status().values["lost"] == "7"
    black_box._write_all()
    black_box.add("ins/imu", b"late", 2 * SECOND_NS)
    black_box.close()
    kept = [(topic, what) for topic, what, _ in read_entries(black_box.path)]
    assert kept == [
        *(("ins/imu", bytes([number])) for number in range(3)),
        (EVENTS_TOPIC, EntriesLost(7)),
        ("ins/imu", b"late"),
        (EVENTS_TOPIC, Closed()),
    ]


def test_queue_for_the_disk_is_bounded_in_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(black_box_module, "MAX_QUEUE_BYTES", 2500)
    monkeypatch.setattr(black_box_module, "FLUSH_PERIOD_S", 60.0)
    black_box = new_black_box(tmp_path / "box.mcap")
    for number in range(5):
        black_box.add("ins/imu", bytes(1000), SECOND_NS + number)
    assert black_box.status().values["lost"] == "3"
    black_box._write_all()
    black_box.add("ins/imu", bytes(1000), 2 * SECOND_NS)
    assert black_box.status().values["lost"] == "3"
    black_box.close()
    events = [what for topic, what, _ in read_entries(black_box.path) if topic == EVENTS_TOPIC]
    assert events == [EntriesLost(3), Closed()]


def test_entries_before_the_first_clock_are_bounded(tmp_path: Path) -> None:
    black_box = new_black_box(tmp_path / "box.mcap")
    for number in range(MAX_ENTRIES_BEFORE_TIME + 5):
        black_box.add("ins/imu", number.to_bytes(4, "little"), 0)
    black_box.add("ins/imu", b"last", SECOND_NS)
    black_box.close()
    kept = [what for topic, what, _ in read_entries(black_box.path) if topic == "ins/imu"]
    assert kept == [number.to_bytes(4, "little") for number in range(5, MAX_ENTRIES_BEFORE_TIME + 5)] + [b"last"]
    assert EntriesLost(5) in [what for topic, what, _ in read_entries(black_box.path) if topic == EVENTS_TOPIC]


def test_a_full_disk_ends_the_black_box_not_the_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(black_box_module, "FLUSH_PERIOD_S", 60.0)
    failures: list[str] = []
    black_box = new_black_box(tmp_path / "box.mcap", failures)
    black_box.add("ins/imu", b"before", SECOND_NS)
    black_box._write_all()
    whole_bytes = black_box.path.stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (whole_bytes + 10, hard))
    try:
        for number in range(1000):
            black_box.add("ins/imu", number.to_bytes(4, "little") * 8, SECOND_NS + number)
        black_box._run_write(black_box._write_all)
        black_box.add("ins/imu", b"after", 2 * SECOND_NS)
        black_box.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert black_box.status().level == Level.ERROR
    assert "File too large" in black_box.status().message
    assert len(failures) == 1
    assert black_box.path.stat().st_size == whole_bytes


def test_black_box_continues_in_a_new_file_after_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(black_box_module, "FLUSH_PERIOD_S", 60.0)
    monkeypatch.setattr(black_box_module, "RETRY_S", 0.0)
    lines: list[str] = []
    black_box = new_black_box(tmp_path / "box.mcap", lines)
    black_box.add("ins/imu", b"before", SECOND_NS)
    black_box._run_write(black_box._write_all)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (black_box.path.stat().st_size + 10, hard))
    try:
        for number in range(1000):
            black_box.add("ins/imu", number.to_bytes(4, "little") * 8, SECOND_NS + number)
        black_box._run_write(black_box._write_all)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
        for _ in range(3):  # repeated attempts leave no file
            black_box.add("ins/imu", b"lost", 2 * SECOND_NS)
            black_box._run_write(black_box._write_all)
        assert [path.name for path in tmp_path.iterdir()] == ["box.mcap"]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    black_box.add("ins/imu", b"after", 3 * SECOND_NS)
    black_box.close()
    assert [line.partition(": ")[0] for line in lines] == [
        f"black box {tmp_path}/box.mcap", f"black box continues in {tmp_path}/box.part2.mcap"
    ]  # fmt: skip
    assert "1003 entries lost: the disk was slow or full, or /clock was missing" in black_box.status().message
    with read_bag(tmp_path / "box.mcap") as bag:
        records = list(bag.records_in_file_order())
    events = [event_from_text(r.decode().data) for r in records if r.topic == EVENTS_TOPIC]
    assert [bytes(r.data) for r in records if r.topic != EVENTS_TOPIC] == [b"before", b"after"]
    assert events == [EntriesLost(1003), Closed()]


def test_black_box_continues_in_a_new_file_at_the_size_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first file gives access to the entries of all files; each file is also a black box with its parameters."""
    monkeypatch.setattr(black_box_module, "FLUSH_PERIOD_S", 60.0)
    black_box = new_black_box(tmp_path / "box.mcap", part_bytes=20_000)
    random = np.random.default_rng(1)
    given = [(SECOND_NS * number, random.bytes(100)) for number in range(1, 301)]
    for number, (time_ns, data) in enumerate(given):
        black_box.add("ins/imu", data, time_ns)
        if number % 50 == 0:
            black_box._run_write(black_box._write_all)
    black_box.close()
    names = sorted(path.name for path in tmp_path.iterdir())
    assert len(names) > 2
    assert names == ["box.mcap", *(f"box.part{number}.mcap" for number in range(2, len(names) + 1))]
    with read_bag(tmp_path / "box.mcap") as bag:
        records = list(bag.records_in_file_order())
        assert bag.problems == []
    assert [(r.log_time_ns, bytes(r.data)) for r in records[:-1]] == given
    assert [r.sequence for r in records] == list(range(1, 302))
    with read_bag(tmp_path / "box.part2.mcap") as bag:
        assert load_config(RelayConfig, bag.attachments[SUITE_ATTACHMENT].decode(), "relay") == CONFIG
    (tmp_path / "box.part2.mcap").unlink()
    with read_bag(tmp_path / "box.mcap") as bag:
        assert bag.problems == ["box.mcap: part 2 of the black box is missing"]
    # Files of an earlier black box are not used for a later one of the same name.
    (tmp_path / "box.mcap").unlink()
    new_black_box(tmp_path / "box.mcap").close()
    with read_bag(tmp_path / "box.mcap") as bag:
        assert len(list(bag.records_in_file_order())) == 1


class RaisingRelay(RelayAdapter):
    def process(self, batch):
        raise RuntimeError("a defect")


def test_a_call_that_raises_is_recorded(tmp_path: Path) -> None:
    black_box = new_black_box(tmp_path / "box.mcap")
    calls = AdapterCalls(RaisingRelay(CONFIG, RosidlFactory()), {}, RecordingFiles(), black_box)
    with pytest.raises(RuntimeError, match="a defect"):
        calls.handle("ins/imu", b"bytes", String(), SECOND_NS)
    with pytest.raises(RuntimeError, match="a defect of a service"):
        calls.service("explode", SECOND_NS)
    black_box.close()
    assert [what for _, what, _ in read_entries(black_box.path)] == [
        b"bytes",
        ServiceCalled("explode", None, None),
        Closed(),
    ]


def test_files_are_recorded_with_content_or_error(tmp_path: Path) -> None:
    files = RecordingFiles()
    files.write(tmp_path / "new" / "a.yaml", b"content")
    assert files.read(tmp_path / "new" / "a.yaml") == b"content"
    with pytest.raises(FileNotFoundError):
        files.read(tmp_path / "none")
    with pytest.raises(NotADirectoryError):
        files.read(tmp_path / "new" / "a.yaml" / "b")
    assert [(Path(use.path).name, use.written, use.content, use.error) for use in files.uses] == [
        ("a.yaml", True, b"content", None),
        ("a.yaml", False, b"content", None),
        ("none", False, None, 2),
        ("b", False, None, 20),
    ]
    assert yaml.safe_load((tmp_path / "new" / "a.yaml").read_bytes()) == "content"
