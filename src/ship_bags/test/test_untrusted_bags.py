"""Malicious bags: data that decompress beyond a limit are refused with their offset, in bounded memory."""

import re
import struct
import subprocess
import sys
import zlib

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from ship_bags.commands import info as info_command
from ship_bags.commands.info import BagContent, bag_content
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.records import MAX_CHUNK_RECORDS, records_of_chunk
from ship_replay.commands import evaluate as evaluate_command
from ship_replay.commands import replay as replay_command
from ship_studies.axis_fit import axis_sightings_command
from ship_studies.ins_noise import identify_noise_command
from ship_studies.installation import calibrate_installation_command
from ship_testing.hand_made_bags import START_NS, write_imu_bag
from ship_testing.mcap_places import places

MESSAGE_HEAD = struct.Struct("<BQHIQQ")
TOO_MANY_BYTES = 300_000_000
COMPRESS = {"zstd": zstandard.ZstdCompressor(level=1).compress, "lz4": lz4.frame.compress, "": bytes}


def message(size, time_ns=START_NS):
    return MESSAGE_HEAD.pack(Opcode.MESSAGE, 22 + size, 1, 0, time_ns, time_ns) + bytes(size)


def chunk_bytes(content, compression, stated, checked=True):
    chunk = Chunk(
        compression=compression,
        data=COMPRESS[compression](content),
        message_end_time=START_NS,
        message_start_time=START_NS,
        uncompressed_crc=zlib.crc32(content) if checked else 0,
        uncompressed_size=len(content) if stated is None else stated,
    )
    builder = RecordBuilder()
    chunk.write(builder)
    return builder.end()


def with_chunks(path, *chunks):
    """Write an unfinished bag of a hundred good messages and then ``chunks``; return the first chunk's offset."""
    data = write_imu_bag(path).read_bytes()
    end = next(offset for offset, opcode, _ in places(data[:-8]) if opcode == Opcode.DATA_END)
    path.write_bytes(data[:end] + b"".join(chunks))
    return end


@pytest.mark.slow
@pytest.mark.parametrize(
    ("compression", "stated", "complaint"),
    [
        ("zstd", None, "its stated size is 300 MB decompressed: at most 256 are read"),
        ("zstd", 1000, "it decompresses to more than 256 MB"),
        ("lz4", 1000, "it decompresses to more than 256 MB"),
        ("zstd", 2**63, "at most 256 are read"),
    ],
)
def test_an_oversized_chunk_is_refused_with_its_offset(tmp_path, compression, stated, complaint):
    content = message(TOO_MANY_BYTES) if stated == 1000 or stated is None else message(10)
    offset = with_chunks(tmp_path / "a.mcap", chunk_bytes(content, compression, stated))
    with read_bag(tmp_path / "a.mcap") as bag:
        assert sum(1 for _ in bag.records()) == 100
        problems = [problem for problem in bag.problems if f"the chunk at byte {offset} is damaged" in problem]
    assert len(problems) == 1
    assert complaint in problems[0]


def test_a_chunk_of_too_many_empty_messages_is_refused(tmp_path):
    content = message(0) * (MAX_CHUNK_RECORDS + 1)
    offset = with_chunks(tmp_path / "a.mcap", chunk_bytes(content, "zstd", None))
    with read_bag(tmp_path / "a.mcap") as bag:
        assert sum(1 for _ in bag.records()) == 100
        expected = f"byte {offset} is damaged (the chunk has more than 1000000 records)"
        assert any(expected in line for line in bag.problems)


def test_a_truncated_chunk_without_checksum_is_damaged(tmp_path):
    whole = message(1000) * 3
    cut = COMPRESS["zstd"](whole)[:-3]
    chunk = Chunk("zstd", cut, START_NS, START_NS, 0, len(whole))
    builder = RecordBuilder()
    chunk.write(builder)
    with_chunks(tmp_path / "a.mcap", builder.end())
    with read_bag(tmp_path / "a.mcap") as bag:
        assert sum(1 for _ in bag.records()) == 100
        assert any("bytes instead of 3093" in line for line in bag.problems)


def test_too_many_overlapping_chunks_are_refused(tmp_path):
    """Each chunk is within its limit, but overlapping chunks of a file of a megabyte would fill any memory."""
    content = message(20_000_000)
    with_chunks(tmp_path / "a.mcap", *[chunk_bytes(content, "zstd", None)] * 30)
    with (
        read_bag(tmp_path / "a.mcap") as bag,
        pytest.raises(BadInput, match=r"a\.mcap: the chunk at byte \d+ and those that overlap it .* more than 512 MB"),
    ):
        list(bag.records())


def test_an_oversized_chunk_needs_bounded_memory(tmp_path):
    """The chunk states 1000 bytes and has no checksum; only the limit bounds the memory."""
    with_chunks(tmp_path / "a.mcap", chunk_bytes(message(600_000_000), "zstd", 1000, checked=False))
    program = f"""
import resource
from pathlib import Path
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.recover import recover
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
path = Path({str(tmp_path)!r}) / "a.mcap"
with read_bag(path) as bag:
    count = sum(1 for _ in bag.records())
print(count, sum(recover(path, path.with_name("whole.mcap")).counts.values()))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    counts, growth_kib = done.stdout.splitlines()
    assert counts == "100 100"
    assert int(growth_kib) < 600_000


@pytest.mark.slow
@pytest.mark.parametrize("text", [b"{secret}", b"\x00" * 1000, b"9" * 5000, b"[" * 100_000, b"a: &a [*a]", b"\xff\xfe"])
def test_a_bad_attached_configuration_is_one_line_and_no_file_is_read(tmp_path, capsys, text):
    (tmp_path / "secret").write_text("root:$6$hash:19000\n")
    attached = text.replace(b"{secret}", str(tmp_path / "secret").encode())
    bag = write_imu_bag(tmp_path / "in.mcap", attachments=[("suite.yaml", attached)])
    for main, arguments in (
        (replay_command.main, ["--out", str(tmp_path / "out.mcap")]),
        (evaluate_command.main, []),
        (calibrate_installation_command.main, ["--out", str(tmp_path / "out.yaml")]),
        (axis_sightings_command.main, ["--out", str(tmp_path / "out.csv")]),
        (identify_noise_command.main, ["--out", str(tmp_path / "noise.yaml")]),
    ):
        assert main([str(bag), *arguments]) == 2
        printed = capsys.readouterr()
        assert printed.err.count("\n") == 1
        assert f"{bag}: " in printed.err
        assert "hash" not in printed.err + printed.out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.mcap", "secret"]


INFORMATION = "rosbag2_bagfile_information:\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        *((text, "not the information file of a rosbag2 bag") for text in ("5", "null", "[1, 2]", "", "a: 1")),
        *((INFORMATION + f"  {text}", "information file") for text in ("5", "null", "- 1")),
        pytest.param("a: [" * 1000, "nested too deeply", id="nested"),
        pytest.param("\x00" * 1000, "not YAML", id="NUL"),
        (INFORMATION + "  storage_identifier: [mcap]\n", "storage_identifier is '['mcap']': expected mcap"),
        (INFORMATION + "  storage_identifier: mcap\n", "relative_file_paths names no file"),
        (INFORMATION + "  storage_identifier: mcap\n  relative_file_paths: 5\n", "relative_file_paths names no file"),
        *(
            (
                INFORMATION + f"  storage_identifier: mcap\n  relative_file_paths: ['{name}']\n",
                f"relative_file_paths: '{name}' is not a file of this folder",
            )
            for name in ("../a.mcap", "/etc/passwd", "sub/../../a.mcap")
        ),
        (INFORMATION + "  storage_identifier: mcap\n  relative_file_paths: [[1], 2]\n", "is not a file of this folder"),
        *(
            (
                INFORMATION + f"  storage_identifier: mcap\n  compression_mode: {mode}\n  relative_file_paths: [a]\n",
                f"compression_mode is '{shown}': expected none or file or message",
            )
            for mode, shown in (("5", "5"), ("LZ4", "lz4"), ("[x]", "['x']"), ("{a: 1}", "{'a': 1}"))
        ),
        pytest.param(
            INFORMATION + f"  storage_identifier: {'9' * 5000}\n",
            "metadata.yaml:2: not YAML: a whole number of more than 64 bits",
            id="digits",
        ),
    ],
)
def test_a_false_information_file_is_refused_in_one_line(tmp_path, text, complaint):
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(BadInput) as caught:
        read_bag(tmp_path)
    assert str(caught.value).startswith(str(tmp_path / "metadata.yaml"))
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_the_records_of_a_chunk_are_those_that_the_library_of_mcap_finds(tmp_path):
    bag = write_imu_bag(tmp_path / "a.mcap", count=3000)
    with bag.open("rb") as stream:
        chunks = [record for record in StreamReader(stream, emit_chunks=True).records if isinstance(record, Chunk)]
    assert len(chunks) > 1
    for chunk in chunks:
        assert records_of_chunk(chunk) == breakup_chunk(chunk, validate_crc=True)


def write_topics(path, count, definition="string data", type_name="std_msgs/msg/String"):
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema(type_name, "ros2msg", definition.encode())
        for number in range(count):
            channel = writer.register_channel(f"/t{number}", "cdr", schema)
            writer.add_message(channel, START_NS + number, b"\0\1\0\0\3\0\0\0hi\0", START_NS + number)
        writer.finish()
    return path


def test_time_of_info_grows_linearly_with_the_topics(tmp_path, monkeypatch):
    """The start of a bag is determined once, not once per topic; MCAP allows 65 000 topics."""
    calls = []
    start = BagContent.start_ns
    monkeypatch.setattr(BagContent, "start_ns", property(lambda content: calls.append(1) or start.fget(content)))
    content = bag_content(write_topics(tmp_path / "many.mcap", 300))
    assert len(list(info_command._lines(tmp_path / "many.mcap", content))) > 300
    assert len(calls) < 10


@pytest.mark.parametrize(
    "definition",
    [
        "".join(f"float64 field_{number}\n" for number in range(250_000)),
        "e_msgs/T0 a\n" + "".join(f"{'=' * 80}\nMSG: e_msgs/T{n}\ne_msgs/T{n + 1} a\n" for n in range(50_000)),
    ],
    ids=["fields", "types"],
)
def test_a_definition_of_megabytes_is_not_parsed(definition, tmp_path, capsys):
    path = write_topics(tmp_path / "large.mcap", 1, definition, "e_msgs/msg/Large")
    with read_bag(path) as bag:
        (problem,) = [each for each in bag.problems if "'/t0'" in each]
        assert list(bag.records()) == []
    assert re.search(r"of e_msgs/msg/Large has \d+ characters without comments, at most 100000", problem)
    assert info_command.main([str(path)]) == 0
    assert "problem: " in capsys.readouterr().out


def test_a_definition_with_megabytes_of_comments_is_read(tmp_path):
    path = write_topics(tmp_path / "comments.mcap", 1, "# x\n" * 1_000_000 + "string data\n", "e_msgs/msg/Large")
    with read_bag(path) as bag:
        assert [record.decode().data for record in bag.records()] == ["hi"]
