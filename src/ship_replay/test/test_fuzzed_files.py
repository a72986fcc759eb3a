"""Files with random mutations through every command that reads them: one line or a result, never a traceback.

Mutated bags get correct checksums, as an attacker would give them.
"""

import io
import os
import random
import shutil
import struct
import zlib
from dataclasses import replace

import pytest
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Schema

from ship_bags.commands import import_nmea as import_nmea_command
from ship_bags.commands import record as record_command
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_node.black_box.black_box_format import VERSIONS_ATTACHMENT
from ship_replay.commands import check_config as check_config_command
from ship_replay.commands import evaluate as evaluate_command
from ship_replay.commands import replay as replay_command
from ship_simulation import simulate_command
from ship_studies.axis_fit import axis_sightings_command, fit_axes_command
from ship_studies.installation import calibrate_installation_command
from ship_testing.mcap_places import places
from ship_testing.ship_logs import GYR1, MWX1, SEAP
from ship_testing.short_scenario import SHORT

# Number of mutations for each command; FUZZ_COUNT=500 tries more.
COUNT = int(os.environ.get("FUZZ_COUNT", "12"))

TEXTS = (
    b"5", b"null", b"[]", b"{}", b"\x00" * 50, b"9" * 5000, b"0x" + b"f" * 5000, b"[" * 3000, b"{a: " * 300,
    b"&a [*a]", b"<<: *x", b".nan", b".inf", b"-1", b"1e999", b"2001-99-99", b"!!binary x", b"!!python/object:os.x {}",
    b"'", b'"\\ud800"', b"\xff\xfe", b"/etc/passwd", b"\x1b[2J", b"~", b"true", b": :", b"? [a]\n: b", b"",
)  # fmt: skip
INFORMATION = """\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  relative_file_paths: [in.mcap]
  compression_format: ""
  compression_mode: ""
"""
SIGHTINGS = "encoder_azimuth_deg,encoder_elevation_deg,azimuth_offset_deg,elevation_offset_deg\n" + "".join(
    f"{40 * number},{10 + 7 * number},{0.01 + 0.001 * number},{-0.01 + 0.002 * (number % 3)}\n" for number in range(9)
)
BOUNDS = "skip_s: 0.5\nfused.heading.rms_arcsec: {max: 300.0}\n"
SCENARIO = SHORT.replace("duration_s: 4.0", "duration_s: 1.0")


@pytest.fixture(scope="module")
def unchanged_inputs(tmp_path_factory):
    """Unchanged inputs of all commands."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "scenario.yaml").write_text(SCENARIO)
    assert simulate_command.main([str(folder / "scenario.yaml"), "--out", str(folder / "in.mcap")]) == 0
    assert replay_command.main([str(folder / "in.mcap"), "--out", str(folder / "out.mcap")]) == 0
    with BagWriter(folder / "run.mcap") as run:
        for name in ("in.mcap", "out.mcap"):
            with read_bag(folder / name) as bag:
                for attachment, content in bag.attachments.items():
                    run.add_attachment(attachment, content)
                for record in bag.records():
                    run.write_raw(record.topic, record.type_name, record.data, record.log_time_ns)
                (folder / "suite.yaml").write_bytes(bag.attachments["suite.yaml"])
        run.add_attachment(VERSIONS_ATTACHMENT, "{}")
        run.add_metadata("note", {"a": "b"})
    for name, text in (
        ("metadata.yaml", INFORMATION), ("sightings.csv", SIGHTINGS), ("bounds.yaml", BOUNDS),
        ("ins.log", SEAP * 3), ("gyro.log", GYR1), ("weather.log", MWX1),
    ):  # fmt: skip
        (folder / name).write_text(text)
    return folder


def mutate(draw, data):
    """Return data with some bytes changed, removed, doubled or replaced by a text that is hard to read."""
    data = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 5))):
        place = draw.randrange(len(data) + 1)
        length = draw.choice((1, 1, 4, 8, 40))
        kind = draw.randrange(5)
        if kind == 0 and place < len(data):
            data[place] ^= 1 << draw.randrange(8)
        elif kind == 1:
            data[place : place + length] = draw.randbytes(length)
        elif kind == 2:
            data[place:place] = data[place : place + length]
        elif kind == 3:
            data[place : place + length] = draw.choice(TEXTS)
        else:
            data[place : place + length] = draw.choice((b"\x00", b"\xff", b"\x7f")) * length
    return bytes(data)


def mutate_text(draw, data):
    """Return data as from :func:`mutate`, or with one value of the text replaced by another."""
    if draw.random() < 0.3:
        return mutate(draw, data)
    words = data.replace(b"\n", b" \n ").split(b" ")
    words[draw.randrange(len(words))] = draw.choice(TEXTS)
    return b" ".join(words)


def raw(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def record_bytes(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def mutate_record(draw, data):
    """Return a bag with a mutation within one of its records and correct checksums; without its summary."""
    end = next(offset for offset, opcode, _ in places(data[:-8]) if opcode == Opcode.DATA_END)
    records = [(opcode, data[offset + 9 : offset + length]) for offset, opcode, length in places(data[:end])]
    target = draw.choice([n for n, (opcode, _) in enumerate(records) if opcode != Opcode.MESSAGE_INDEX])
    opcode, body = records[target]
    if opcode == Opcode.CHUNK:
        chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
        content = mutate_content(draw, zstandard.decompress(chunk.data))
        packed = zstandard.ZstdCompressor().compress(content)
        checksum, size = zlib.crc32(content), len(content)
        new = record_bytes(replace(chunk, data=packed, uncompressed_crc=checksum, uncompressed_size=size))
    elif opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(ReadDataStream(io.BytesIO(body)))
        text = draw.choice((mutate_text(draw, attachment.data), draw.choice(TEXTS)))
        new = record_bytes(replace(attachment, data=text))
    else:
        new = raw(opcode, mutate(draw, body))
    return data[:8] + b"".join(new if n == target else raw(*record) for n, record in enumerate(records))


def mutate_content(draw, content):
    """Return content with a mutation within one record of a chunk, often a definition, which has most effect."""
    if draw.random() < 0.1:
        return mutate(draw, content)
    records, offset = [], 0
    while offset < len(content):
        opcode, length = struct.unpack_from("<BQ", content, offset)
        records.append((opcode, content[offset + 9 : offset + 9 + length]))
        offset += 9 + length
    kinds = sorted({opcode for opcode, _ in records})
    kind = draw.choice(kinds)
    target = draw.choice([n for n, (opcode, _) in enumerate(records) if opcode == kind])
    new = mutate(draw, records[target][1])
    if kind == Opcode.SCHEMA:
        schema = Schema.read(ReadDataStream(io.BytesIO(records[target][1])))
        new = record_bytes(replace(schema, data=mutate_text(draw, schema.data)))[9:]
    elif kind == Opcode.CHANNEL:
        channel = Channel.read(ReadDataStream(io.BytesIO(records[target][1])))
        texts = {key: mutate(draw, text.encode()).decode("latin-1") for key, text in channel.metadata.items()}
        new = record_bytes(replace(channel, metadata=texts))[9:]
    return b"".join(raw(opcode, new if n == target else body) for n, (opcode, body) in enumerate(records))


def bag(draw, data):
    """Return a mutated bag: with correct checksums, or damaged as by a disk."""
    choice = draw.random()
    if choice < 0.75:
        return mutate_record(draw, data)
    return mutate(draw, data) if choice < 0.9 else data[: draw.randrange(len(data))]


# Kind of file → its name, the function that changes it, the commands that read it; {} is the mutated one.
KINDS = {
    "bag": (
        "run.mcap",
        bag,
        [
            (replay_command, ["{}", "--out", "new.mcap"]),
            (replay_command, ["{}", "--verify"]),
            (evaluate_command, ["{}", "--json", "new.json"]),
            (calibrate_installation_command, ["{}", "--out", "new.yaml"]),
            (axis_sightings_command, ["{}", "--out", "new.csv"]),
            (check_config_command, ["suite.yaml", "{}"]),
            (record_command, ["--recover", "{}", "--out", "new.mcap"]),
        ],
    ),
    "suite": (
        "suite.yaml",
        mutate_text,
        [
            (check_config_command, ["{}", "in.mcap"]),
            (replay_command, ["in.mcap", "--out", "new.mcap", "--config", "{}"]),
            (calibrate_installation_command, ["in.mcap", "--out", "new.yaml", "--config", "{}"]),
        ],
    ),
    "scenario": ("scenario.yaml", mutate_text, [(simulate_command, ["{}", "--out", "new.mcap"])]),
    "information": ("metadata.yaml", mutate_text, [(evaluate_command, ["{folder}"])]),
    "bounds": ("bounds.yaml", mutate_text, [(evaluate_command, ["run.mcap", "--bounds", "{}"])]),
    "sightings": ("sightings.csv", mutate_text, [(fit_axes_command, ["{}", "--out", "fit"])]),
    "log": ("ins.log", mutate_text, [(import_nmea_command, ["--ins", "{}", "--out", "new.mcap"])]),
    "gyro log": (
        "gyro.log",
        mutate_text,
        [(import_nmea_command, ["--ins", "ins.log", "--gyro", "{}", "--out", "new.mcap"])],
    ),
    "weather log": (
        "weather.log",
        mutate_text,
        [(import_nmea_command, ["--ins", "ins.log", "--weather", "{}", "--out", "new.mcap"])],
    ),
}


# Values in a mutated message may overflow.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("kind", KINDS)
def test_no_mutation_of_a_file_ends_in_a_traceback(kind, unchanged_inputs, tmp_path, monkeypatch, capsys):
    name, change, commands = KINDS[kind]
    data = (unchanged_inputs / name).read_bytes()
    monkeypatch.chdir(unchanged_inputs)
    for seed in range(COUNT * len(commands)):
        place = tmp_path / str(seed)
        place.mkdir()
        path = place / name
        path.write_bytes(change(random.Random(seed), data))
        if kind == "information":
            shutil.copy(unchanged_inputs / "in.mcap", place)
        command, arguments = commands[seed % len(commands)]
        given = [argument.format(path, folder=place) for argument in arguments]
        given = [str(place / text) if text == "fit" or text.startswith("new.") else text for text in given]
        code = command.main(given)
        printed = capsys.readouterr()
        assert code in (0, 1, 2), seed
        assert code == 2 or not printed.err, (seed, printed.err)
        if code == 2 and command is not check_config_command:
            assert printed.err.count("\n") == 1, (seed, printed.err)
        assert len(printed.err) < 3000, seed
        assert "\x1b" not in printed.err + printed.out, seed
        assert not list(place.rglob("*.part*")), seed
        shutil.rmtree(place)
