"""Topics of bags as tables, read back by readers that are not ours: csv, pyarrow, scipy."""

import csv
import shutil
import struct
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from mcap.writer import Writer
from rosbags.interfaces import Nodetype
from scipy.io import netcdf_file

from ship_bags.commands.export import main
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.message_store import definition, message_store, serialize
from ship_testing.hand_made_bags import START_NS, imu, write_imu_bag
from ship_testing.random_messages import TIMES, dtype, random_message

ROOT = Path(__file__).parents[3]
SUFFIXES = {"csv": ".csv", "parquet": ".parquet", "netcdf": ".nc"}
PACKAGES = ("ship_msgs", "sensor_msgs", "geometry_msgs", "diagnostic_msgs", "std_msgs")
TYPES = [
    name
    for name in message_store().fielddefs
    # Nothing is in Empty, and nobody sends WString: the decoder does not know it.
    if name.startswith(PACKAGES) and "/msg/" in name and not name.endswith(("/Empty", "/WString"))
]
NUMBERED_UP_TO = 64


def read_table(path):
    """Names of the columns and the rows, as csv, pyarrow or scipy give them; split integers are put together."""
    if path.suffix == ".csv":
        with open(path, newline="", encoding="utf-8") as file:
            names, *rows = csv.reader(file)
        return names, rows
    if path.suffix == ".parquet":
        table = pyarrow.parquet.read_table(path)
        columns = [column.to_pylist() for column in table.columns]
        return table.column_names, [list(row) for row in zip(*columns, strict=True)]
    with netcdf_file(path, mmap=False) as file:
        columns = {name: values(variable) for name, variable in file.variables.items() if name != "time"}
    for name in [name for name in columns if name.endswith("_remainder")]:
        whole = name.removesuffix("_remainder")
        columns[whole] = [int(near) + int(rest) for near, rest in zip(columns[whole], columns.pop(name), strict=True)]
    return list(columns), [list(row) for row in zip(*columns.values(), strict=True)]


def values(variable):
    if variable.data.dtype.kind == "S":
        return [row.tobytes().rstrip(b"\0").decode() for row in variable.data]
    return variable.data.tolist()


class Rebuilder:
    """Makes the messages of a topic from its tables, in the order in which the definition names the fields."""

    def __init__(self, folder, stem, suffix):
        self.paths = {path.name.removesuffix(suffix): path for path in folder.glob(f"{stem}*{suffix}")}
        self.stem = stem
        self.store = message_store()
        self.elements = {}

    def messages(self, type_name):
        _, rows = read_table(self.paths[self.stem])
        for number, row in enumerate(rows):
            assert int(row[1]) == number
            left = iter(row[2:])
            yield int(row[0]), self.message(type_name, left, (number,), "", "")
            assert list(left) == []

    def message(self, type_name, left, keys, table, path):
        fields = {}
        for name, (node, content) in self.store.fielddefs[type_name][1]:
            fields[name] = self.value(node, content, left, keys, table, f"{path}_{name}".lstrip("_"))
        return self.store.types[type_name](**fields)

    def value(self, node, content, left, keys, table, path):
        if node == Nodetype.BASE:
            return cast(content[0], next(left))
        if node == Nodetype.NAME:
            if content in TIMES:
                sec, nanosec = divmod(int(next(left)), 1_000_000_000)
                return self.store.types[content](sec, nanosec)
            return self.message(content, left, keys, table, path)
        (element_node, element), length = content
        numbered = node == Nodetype.ARRAY and length <= NUMBERED_UP_TO
        if numbered:
            found = [
                self.value(element_node, element, left, keys, table, f"{path}_{place}") for place in range(length)
            ]
        elif element_node == Nodetype.BASE and element[0] in ("uint8", "byte", "octet"):
            return np.frombuffer(bytes.fromhex(next(left)), np.uint8)
        else:
            name = f"{table}-{path}".lstrip("-")
            count = int(next(left))
            found = [self.element(name, path, (*keys, i), element_node, element) for i in range(count)]
            assert (*keys, count) not in self.rows_of(name, path)
        if element_node == Nodetype.NAME or element[0] == "string":
            return found
        return np.array(found, dtype(element[0]))

    def element(self, table, path, keys, node, content):
        left = iter(self.rows_of(table, path)[keys])
        built = self.value(node, content, left, keys, table, "")
        assert list(left) == []
        return built

    def rows_of(self, table, path):
        if table not in self.elements:
            names, rows = read_table(self.paths[f"{self.stem}-{table}"])
            last = names.index(f"{path}_index")
            places = [place for place in range(last + 1) if names[place] not in ("log_time_ns", "stamp_ns")]
            self.elements[table] = {tuple(int(row[place]) for place in places): row[last + 1 :] for row in rows}
        return self.elements[table]


def cast(base, value):
    if base == "string":
        return value
    if base == "bool":
        return bool(int(value))
    if base == "byte":
        return (int(value) + 128) % 256 - 128  # rosbags reads and writes it with a sign
    kind = dtype(base)
    return float(kind.type(float(value))) if kind.kind == "f" else int(value)


def topic_of(type_name):
    return type_name.replace("/msg/", "/").lower()


@pytest.fixture(scope="module")
def hard_bag(tmp_path_factory):
    """Every type of the packages, five messages each, of values that are hard to keep."""
    rng = np.random.default_rng(13)
    path = tmp_path_factory.mktemp("bags") / "hard.mcap"
    with BagWriter(path) as bag:
        for type_name in TYPES:
            for number in range(5):
                message = random_message(type_name, message_store(), rng)
                bag.write(topic_of(type_name), message, START_NS + number * 12_345_678_901)
    return path


@pytest.mark.parametrize("kind", SUFFIXES)
def test_what_is_read_back_gives_the_same_bytes_for_every_type(kind, hard_bag, tmp_path):
    assert main([str(hard_bag), "--out", str(tmp_path), "--format", kind]) == 0
    with read_bag(hard_bag) as bag:
        written = {}
        for record in bag.records():
            written.setdefault(record.topic, []).append((record.log_time_ns, serialize(record.decode())))
    for type_name in TYPES:
        stem = topic_of(type_name).replace("/", ".")
        rebuilt = Rebuilder(tmp_path, stem, SUFFIXES[kind])
        found = [(time_ns, serialize(message)) for time_ns, message in rebuilt.messages(type_name)]
        assert found == written[topic_of(type_name)], type_name


@pytest.mark.parametrize("kind", SUFFIXES)
@pytest.mark.parametrize("name", ["demo", "theodolite"])
def test_the_bags_of_the_repository_come_back_bit_for_bit(kind, name, tmp_path):
    path = ROOT / "bags" / f"{name}.mcap"
    topics = ["truth/attitude", "truth/alignment", "gnss/fix", "met/pressure"]
    topics += ["theodolite/beacons", "truth/pointing"] if name == "theodolite" else ["star/fore/horizon_attitude"]
    assert main([str(path), "--out", str(tmp_path), "--format", kind, "--topics", *topics]) == 0
    with read_bag(path) as bag:
        types = bag.topics
        written = {topic: [] for topic in topics}
        for record in bag.records(topics):
            written[record.topic].append((record.log_time_ns, serialize(record.decode())))
    for topic in topics:
        rebuilt = Rebuilder(tmp_path, topic.replace("/", "."), SUFFIXES[kind])
        found = [(time_ns, serialize(message)) for time_ns, message in rebuilt.messages(types[topic])]
        assert found == written[topic], topic
        assert len(found) > 50
