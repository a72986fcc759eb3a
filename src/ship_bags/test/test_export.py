"""Topics of bags as tables, read back by independent readers: csv, pyarrow, scipy."""

import csv
import re
import resource
import signal
import struct
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.interfaces import Nodetype
from scipy.io import netcdf_file

from ship_bags.commands.export import main
from ship_bags.export.message_fields import value_names
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.mcap.folder import FolderWriter, SplitLimits
from ship_bags.message_store import definition, message_store, serialize
from ship_testing.hand_made_bags import START_NS, imu, innovation, write_imu_bag
from ship_testing.random_messages import TIMES, dtype, random_message

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed: make setup-all")

ROOT = Path(__file__).parents[3]
SUFFIXES = {"csv": ".csv", "parquet": ".parquet", "netcdf": ".nc"}
PACKAGES = ("ship_msgs", "sensor_msgs", "geometry_msgs", "diagnostic_msgs", "std_msgs")
TYPES = [
    name
    for name in message_store().fielddefs
    # Empty has no field, and WString is not supported by the decoder.
    if name.startswith(PACKAGES) and "/msg/" in name and not name.endswith(("/Empty", "/WString"))
]
NUMBERED_UP_TO = 64
TOGETHER = [
    ("AlignmentState", {"names": 1, "values": 1, "units": 1}),
    ("TheodoliteCalibration", {"names": 1, "values": 1, "units": 1}),
    ("ErrorBudget", {"sources": 1, "covariances": 9}),
    ("Innovation", {"components": 1, "residual": 1, "sigma": 1}),
    ("InputHealth", {"reasons": 1, "reason_counts": 1}),
    ("Integrity", {"quantities": 1, "protection_level": 1, "alert_limit": 1}),
    ("Integrity", {"hypotheses": 1, "statistic": 1, "threshold": 1}),
    ("Integrity", {"excluded": 1, "excluded_for_s": 1}),
    ("JointState", {"name": 1, "position": 1, "velocity": 1, "effort": 1}),
]
"""Arrays that share a table: last part of the message type → name of the array → number of its elements in a table row.
"""


def constants(type_name):
    return [name for name, _, _ in message_store().fielddefs[type_name][0]]


def read_table(path):
    """Return column names and rows as csv, pyarrow or scipy give them; split integers are combined."""
    if path.suffix == ".csv":
        with open(path, newline="", encoding="utf-8") as file:
            names, *rows = csv.reader(file)
        return names, rows
    if path.suffix == ".parquet":
        table = parquet.read_table(path)
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
    """Rebuilds the messages of a topic from its tables, whose columns are in the order of the definition's fields."""

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
            self.type_name = type_name
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
            count = int(next(left))
            shared = next((g for t, g in TOGETHER if self.type_name.endswith(f"/{t}") and path in g), {path: 1})
            first, width = next(iter(shared)), shared[path]
            name = f"{table}-{first}".lstrip("-")
            before = sum(list(shared.values())[: list(shared).index(path)])
            places = [((*keys, place // width), before + place % width) for place in range(count)]
            found = [self.element(name, first, *at, element_node, element) for at in places]
            beyond = self.rows_of(name, first).get((*keys, -(-count // width)))
            assert beyond is None or (len(shared) > 1 and is_nothing(beyond[before]))
        if element_node == Nodetype.NAME or element[0] == "string":
            return found
        return np.array(found, dtype(element[0]))

    def element(self, table, first, keys, place, node, content):
        return self.value(node, content, iter(self.rows_of(table, first)[keys][place:]), keys, table, "")

    def rows_of(self, table, path):
        if table not in self.elements:
            names, rows = read_table(self.paths[f"{self.stem}-{table}"])
            last = names.index(f"{path}_index")
            places = [place for place in range(last + 1) if names[place] not in ("log_time_ns", "stamp_ns")]
            self.elements[table] = {tuple(int(row[place]) for place in places): row[last + 1 :] for row in rows}
        return self.elements[table]


def is_nothing(value):
    """Return True if a cell is what a format writes beyond the end of a shorter array."""
    return value in ("", None, 0) or value != value


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
    """Return a bag with five messages of every type of the packages, with extreme values."""
    rng = np.random.default_rng(13)
    path = tmp_path_factory.mktemp("bags") / "hard.mcap"
    with BagWriter(path) as bag:
        for type_name in TYPES:
            for number in range(5):
                message = random_message(type_name, message_store(), rng)
                bag.write(topic_of(type_name), message, START_NS + number * 12_345_678_901)
    return path


@pytest.mark.slow
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


def test_csv_has_no_more_digits_than_a_number_needs(tmp_path):
    with BagWriter(tmp_path / "a.mcap") as bag:
        bag.write("single", message_store().types["std_msgs/msg/Float32"](float(np.float32(0.1))), START_NS)
        bag.write("double", message_store().types["std_msgs/msg/Float64"](0.1), START_NS)
    assert main([str(tmp_path / "a.mcap"), "--out", str(tmp_path / "out")]) == 0
    assert read_table(tmp_path / "out" / "single.csv")[1][0][2:] == ["0.1"]
    assert read_table(tmp_path / "out" / "double.csv")[1][0][2:] == ["0.1"]


FORMULAS = ["=HYPERLINK(\"http://evil.example\")", "+1+cmd|' /C calc'!A0", "-2+3", "@SUM(1)", "\t=1", "\r=1", "－1+1"]
TEXTS = ["-1.5", "+2", "-inf", "1-2", "a=b", "", " =1", "star.fore"]


def test_a_text_in_csv_is_no_formula_and_a_number_stays_one(tmp_path):
    with BagWriter(tmp_path / "a.mcap") as bag:
        for text in (*FORMULAS, *TEXTS):
            bag.write("text", message_store().types["std_msgs/msg/String"](text), START_NS)
        bag.write("number", message_store().types["std_msgs/msg/Float64"](-1.5), START_NS)
    assert main([str(tmp_path / "a.mcap"), "--out", str(tmp_path / "out")]) == 0
    shown = [row[-1] for row in read_table(tmp_path / "out" / "text.csv")[1]]
    assert shown == [*(f"'{text}" for text in FORMULAS), *TEXTS]
    assert read_table(tmp_path / "out" / "number.csv")[1][0][2:] == ["-1.5"]


@pytest.mark.slow
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


def names_of(type_name, tmp_path):
    """Return the columns of each table of one message."""
    path = tmp_path / "one.mcap"
    with BagWriter(path) as bag:
        bag.write("a", random_message(type_name, message_store(), np.random.default_rng(1)), START_NS)
    assert main([str(path), "--out", str(tmp_path / "out")]) == 0
    return {table.name.removesuffix(".csv"): read_table(table)[0] for table in sorted((tmp_path / "out").iterdir())}


def test_column_names_have_the_units_of_the_definitions(tmp_path):
    columns = names_of("ship_msgs/msg/ShipAttitude", tmp_path)["a"]
    assert columns[:8] == [
        "log_time_ns", "message_index", "stamp_ns", "frame_id", "heading_rad", "pitch_rad", "roll_rad",
        "covariance_rad2_0",
    ]
    assert {"orientation_w", "angular_velocity_z_rad_per_s", "sources_count", "star_age_s", "status"} < set(columns)


def test_a_comment_holds_for_the_fields_up_to_the_next_one(tmp_path):
    columns = names_of("ship_msgs/msg/AttitudeErrorArcsec", tmp_path)["a"]
    assert columns[-2:] == ["error_pitch_arcsec", "error_roll_arcsec"]


def test_a_unit_that_depends_on_the_message_is_not_guessed(tmp_path):
    tables = names_of("ship_msgs/msg/Innovation", tmp_path)
    assert tables["a-components"][-3:] == ["components", "residual", "sigma"]  # [rad, or m for baselines]
    assert "pose_covariance_35" in names_of_again("geometry_msgs/msg/PoseWithCovarianceStamped", tmp_path)["a"]


def names_of_again(type_name, tmp_path):
    (tmp_path / "again").mkdir()
    return names_of(type_name, tmp_path / "again")


def test_units_of_common_messages_and_of_arrays_of_messages(tmp_path):
    columns = names_of("sensor_msgs/msg/NavSatFix", tmp_path)["a"]
    assert {"latitude_deg", "altitude_m", "position_covariance_m2_8"} < set(columns)
    tables = names_of_again("ship_msgs/msg/StarObservationArray", tmp_path)
    assert tables["a-stars"] == [
        "log_time_ns", "message_index", "stamp_ns", "stars_index", "catalogue_id", "right_ascension_rad",
        "declination_rad", "u_px", "v_px", "sigma_px", "magnitude",
    ]


def test_arrays_within_arrays_are_tables_that_name_both_places(tmp_path):
    tables = names_of("diagnostic_msgs/msg/DiagnosticArray", tmp_path)
    assert tables["a-status-values"] == [
        "log_time_ns", "message_index", "stamp_ns", "status_index", "values_index", "key", "value",
    ]


def test_arrays_in_the_same_order_share_a_table_also_where_one_is_shorter(tmp_path):
    """An innovation rejected before the comparison has no residual, see Innovation.msg."""
    path = tmp_path / "a.mcap"
    with BagWriter(path) as bag:
        message = innovation(START_NS, "star.fore", [], [], float("nan"), components=["north", "up", "east"])
        bag.write("a", message, START_NS)
        message = innovation(START_NS, "star.fore", [1.0, 2.0], [3.0, 4.0], 5.0, components=["n", "u"])
        bag.write("a", message, START_NS + 1)
    for kind, nothing in {"csv": "", "parquet": None, "netcdf": "nan"}.items():
        assert main([str(path), "--out", str(tmp_path / kind), "--format", kind]) == 0
        names, rows = read_table(tmp_path / kind / f"a-components{SUFFIXES[kind]}")
        place = names.index("components")
        shown = [[row[place], *(None if cell is None else str(cell) for cell in row[place + 1 :])] for row in rows]
        expected = [[name, nothing, nothing] for name in ("north", "up", "east")]
        assert shown == [*expected, ["n", "1.0", "3.0"], ["u", "2.0", "4.0"]]
        names, rows = read_table(tmp_path / kind / f"a{SUFFIXES[kind]}")
        assert [int(row[names.index("residual_count")]) for row in rows] == [0, 2]


def test_a_source_of_an_error_budget_stands_with_its_covariance(tmp_path):
    budget = message_store().types["ship_msgs/msg/ErrorBudget"](
        imu(START_NS).header, "ship_attitude", ["ins", "star.bow"], np.arange(18.0), np.zeros(9)
    )
    with BagWriter(tmp_path / "a.mcap") as bag:
        bag.write("a", budget, START_NS)
    assert main([str(tmp_path / "a.mcap"), "--out", str(tmp_path)]) == 0
    names, rows = read_table(tmp_path / "a-sources.csv")
    assert names[3:6] == ["sources_index", "sources", "covariances_rad2_0"]
    assert [row[4:] for row in rows] == [
        ["ins", *(f"{n}.0" for n in range(9))],
        ["star.bow", *(f"{n}.0" for n in range(9, 18))],
    ]


def test_netcdf_has_the_required_attributes_and_no_path(tmp_path):
    assert main([str(ROOT / "bags" / "demo.mcap"), "--topics", "truth/attitude", "--out", str(tmp_path / "a.nc")]) == 0
    with netcdf_file(tmp_path / "a.nc", mmap=False) as file:
        assert file.Conventions == b"CF-1.8"
        assert file.history == b"ship_bags export of demo.mcap"
        axis, heading = file.variables["time"], file.variables["heading_rad"]
        assert (axis.standard_name, axis.axis, axis.calendar) == (b"time", b"T", b"standard")
        assert axis.units == b"seconds since 2014-07-09 00:00:00"
        assert axis.dimensions == heading.dimensions == ("row",)
        # From the standard name table: clockwise from North, as in the message.
        assert (heading.standard_name, heading.units) == (b"platform_orientation", b"rad")
        assert file.variables["pitch_rad"].standard_name == b"platform_pitch_fore_up"
        assert file.variables["roll_rad"].standard_name == b"platform_roll_starboard_down"
        assert heading.coordinates == b"time"
        near, rest = (file.variables[name].data.tolist() for name in ("stamp_ns", "stamp_ns_remainder"))
        stamps = [int(first) + second for first, second in zip(near, rest, strict=True)]
        midnight_ns = 1_404_864_000_000_000_000  # date -d 2014-07-09T00:00:00Z +%s
        assert np.abs(axis.data * 1e9 - (np.array(stamps) - midnight_ns)).max() < 0.5
    assert str(tmp_path).encode() not in (tmp_path / "a.nc").read_bytes()


def flags(path):
    """Return name of a variable → meanings of its values, as in a NetCDF file."""
    with netcdf_file(path, mmap=False) as file:
        flagged = {name: each for name, each in file.variables.items() if hasattr(each, "flag_meanings")}
        # CF requires flag_values of the variable's type. scipy reads a single flag value as a scalar, so only arrays
        # are compared.
        arrays = [each for each in flagged.values() if np.ndim(each.flag_values)]
        assert all(each.flag_values.dtype == each.data.dtype for each in arrays)
        return {
            name: dict(zip(np.atleast_1d(each.flag_values).tolist(), each.flag_meanings.decode().split(), strict=True))
            for name, each in flagged.items()
        }


def netcdf_of(type_name, folder):
    """Write a message of a type as NetCDF into a folder."""
    with BagWriter(folder / "one.mcap") as bag:
        bag.write("a", random_message(type_name, message_store(), np.random.default_rng(1)), START_NS)
    assert main([str(folder / "one.mcap"), "--out", str(folder), "--format", "netcdf", "--force"]) == 0


def test_netcdf_names_the_values_of_enumerations(tmp_path):
    worth = {0: "VALID", 1: "COASTING", 2: "DEGRADED", 3: "INVALID"}
    modes = {0: "TWO_LIGHTS", 1: "ONE_LIGHT", 2: "ENCODER", 3: "STARS", 4: "STARS_AND_LIGHTS"}
    netcdf_of("ship_msgs/msg/OpticalAxisPointing", tmp_path)
    assert flags(tmp_path / "a.nc") == {"mode": modes, "status": worth}
    netcdf_of("ship_msgs/msg/ShipAttitude", tmp_path)
    assert flags(tmp_path / "a.nc") == {"status": worth, "horizon": {0: "GEODETIC", 1: "GRAVITY"}}
    netcdf_of("ship_msgs/msg/AlertArray", tmp_path)
    assert flags(tmp_path / "a-alerts.nc")["priority"] == {0: "CAUTION", 1: "WARNING", 2: "ALARM"}
    assert flags(tmp_path / "a-alerts.nc")["state"][4] == "RECTIFIED_UNACKNOWLEDGED"
    netcdf_of("sensor_msgs/msg/NavSatFix", tmp_path)
    found = flags(tmp_path / "a.nc")
    assert found["status_status"][-1] == "STATUS_NO_FIX"
    assert found["position_covariance_type"][3] == "COVARIANCE_TYPE_KNOWN"
    assert "status_service" not in found  # its values are added up
    netcdf_of("diagnostic_msgs/msg/DiagnosticArray", tmp_path)
    assert flags(tmp_path / "a-status.nc") == {"level": {0: "OK", 1: "WARN", 2: "ERROR", 3: "STALE"}}


def test_the_page_names_the_values_as_the_definitions_do():
    page = (ROOT / "docs" / "how-to" / "export.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (`.*`) \| (0 .*) \|$", page, re.MULTILINE)
    assert len(rows) == 9
    for column, types, text in rows:
        documented = {name: int(value) for value, name in (each.split() for each in text.split(", "))}
        for name in re.findall(r"\w+", types):
            type_name = f"ship_msgs/msg/{name}"
            assert value_names(type_name, column, message_store().fielddefs[type_name][0]) == documented


@pytest.mark.parametrize("type_name", [name for name in TYPES if name.startswith("ship_msgs") and constants(name)])
def test_every_constant_of_our_messages_is_a_value_of_a_field(type_name, tmp_path):
    netcdf_of(type_name, tmp_path)
    named = [name for meanings in flags(tmp_path / "a.nc").values() for name in meanings.values()]
    assert sorted(named) == sorted(constants(type_name))


def test_constants_of_a_bag_that_its_field_cannot_hold_are_no_values(tmp_path):
    text = 'uint8 VALID=0\nint32 COASTING=70000\nstring INVALID="no"\nuint8 status'
    write_defined(tmp_path / "odd.mcap", text, b"\1", name="ship_msgs/msg/ShipAttitude")
    assert main([str(tmp_path / "odd.mcap"), "--out", str(tmp_path / "a.nc")]) == 0
    assert flags(tmp_path / "a.nc") == {"status": {0: "VALID"}}


def test_cf_standard_names_are_used_where_certain(tmp_path):
    topics = ["gnss/fix", "met/pressure", "met/temperature", "met/humidity"]
    arguments = [str(ROOT / "bags" / "demo.mcap"), "--topics", *topics, "--out", str(tmp_path)]
    assert main([*arguments, "--format", "netcdf"]) == 0
    found = {}
    for topic in topics:
        with netcdf_file(tmp_path / f"{topic.replace('/', '.')}.nc", mmap=False) as file:
            for variable in file.variables.values():
                if hasattr(variable, "standard_name") and variable.standard_name != b"time":
                    found[variable.standard_name.decode()] = variable.units.decode()
    assert found == {
        "latitude": "degrees_north", "longitude": "degrees_east", "height_above_reference_ellipsoid": "m",
        "air_pressure": "Pa", "air_temperature": "degC", "relative_humidity": "1",
    }


@pytest.mark.parametrize("kind", SUFFIXES)
def test_a_table_without_rows_has_its_columns(kind, tmp_path):
    path = tmp_path / "empty_arrays.mcap"
    with BagWriter(path) as bag:
        bag.add_topic("never", "sensor_msgs/msg/Imu")
        for number in range(3):
            array = message_store().types["ship_msgs/msg/AlertArray"](header=imu(START_NS).header, alerts=[])
            bag.write("alerts", array, START_NS + number)
    assert main([str(path), "--out", str(tmp_path / "out"), "--format", kind]) == 0
    for stem, count in {"alerts": 3, "alerts-alerts": 0, "never": 0}.items():
        names, rows = read_table(tmp_path / "out" / f"{stem}{SUFFIXES[kind]}")
        assert "log_time_ns" in names
        assert len(rows) == count


@pytest.mark.parametrize("kind", SUFFIXES)
def test_many_batches_are_one_table(kind, tmp_path):
    write_imu_bag(tmp_path / "long.mcap", 3500)
    out = tmp_path / f"imu{SUFFIXES[kind]}"
    assert main([str(tmp_path / "long.mcap"), "--out", str(out)]) == 0
    names, rows = read_table(out)
    stamps = [int(row[names.index("stamp_ns")]) for row in rows]
    assert stamps == [START_NS + number * 10_000_000 for number in range(3500)]
    assert {path.name for path in tmp_path.iterdir()} == {"long.mcap", out.name}


def test_only_the_requested_time_range(tmp_path):
    write_imu_bag(tmp_path / "long.mcap", 100)  # from 2023-11-14T22:13:20.05Z on, at 100 Hz
    arguments = [str(tmp_path / "long.mcap"), "--out", str(tmp_path / "a.csv")]
    assert main([*arguments, "--from", "2023-11-14T22:13:20.1Z", "--to", "2023-11-14T22:13:20.15Z"]) == 0
    _, rows = read_table(tmp_path / "a.csv")
    assert [int(row[0]) - START_NS for row in rows] == [50_000_000 + 10_000_000 * number for number in range(5)]


@pytest.mark.parametrize(
    ("since", "until", "why"),
    [
        ("2023-11-14T22:13:20.15Z", "2023-11-14T22:13:20.1Z", "--from 2023-11-14T22:13:20.150Z is not before --to"),
        ("2023-11-14T22:13:20.1Z", "2023-11-14T22:13:20.1Z", "--from 2023-11-14T22:13:20.100Z is not before --to"),
        ("2024-01-01T00:00:00Z", "2024-01-02T00:00:00Z", "the bag is from 2023-11-14T22:13:20.050Z to"),
        ("2022-01-01T00:00:00Z", "2022-01-02T00:00:00Z", "the bag is from 2023-11-14T22:13:20.050Z to"),
    ],
)
def test_an_empty_time_range_keeps_existing_files(since, until, why, imu_bag, tmp_path, capsys):
    (tmp_path / "a.csv").write_text("precious")
    line = refusal([imu_bag, "--out", tmp_path / "a.csv", "--force", "--from", since, "--to", until], capsys)
    assert why in line
    assert (tmp_path / "a.csv").read_text() == "precious"
    assert {path.name for path in tmp_path.iterdir()} == {"imu.mcap", "a.csv"}


def test_a_topic_without_messages_in_the_time_range_is_reported(tmp_path, capsys):
    with BagWriter(tmp_path / "two.mcap") as bag:
        bag.write("early", imu(START_NS), START_NS)
        bag.write("first", imu(START_NS), START_NS)
        bag.write("late", imu(START_NS), START_NS + 10_000_000_000)
    arguments = [str(tmp_path / "two.mcap"), "--out", str(tmp_path / "out"), "--from", "2023-11-14T22:13:25Z"]
    for kind, suffix in SUFFIXES.items():
        assert main([*arguments, "--format", kind]) == 0
        expected = "no message was logged between --from and --to, so no file is written for 'early', 'first'"
        assert capsys.readouterr().err == f"export: {expected}\n"
        assert [path.name for path in (tmp_path / "out").glob(f"*{suffix}*")] == [f"late{suffix}"]
    assert main([*arguments, "--topics", "early"]) == 2
    line = capsys.readouterr().err
    assert "no message of these topics was logged between --from and --to: the bag is from 2023-11-14T22:13:20" in line


@pytest.mark.parametrize("text", ["yesterday", "2026-13-01T00:00:00Z", "2026-06-01T20:00:00.1234567890Z", "1700000000"])
def test_an_invalid_time_is_refused(text, imu_bag, tmp_path, capsys):
    with pytest.raises(SystemExit) as left:
        main([str(imu_bag), "--out", str(tmp_path / "a.csv"), "--from", text])
    assert left.value.code == 2
    assert f"'{text}' is not a UTC time like 2026-06-01T20:00:30.5Z" in capsys.readouterr().err


def test_a_time_is_exact_to_the_nanosecond(tmp_path):
    write_imu_bag(tmp_path / "a.mcap", 3)
    arguments = [str(tmp_path / "a.mcap"), "--out", str(tmp_path / "a.csv"), "--force", "--to"]
    for until, count in {"2023-11-14T22:13:20.060000000Z": 1, "2023-11-14 22:13:20.060000001": 2}.items():
        assert main([*arguments, until]) == 0
        assert len(read_table(tmp_path / "a.csv")[1]) == count


def test_a_rosbag2_folder_is_one_table(tmp_path):
    bag = FolderWriter(tmp_path / "folder", SplitLimits(size_bytes=1))
    for number in range(3):
        bag.write_raw("ins/imu", "sensor_msgs/msg/Imu", serialize(imu(START_NS + number)), START_NS + number)
        bag.flush()
    bag.close()
    assert len(list((tmp_path / "folder").glob("*.mcap"))) > 2
    assert main([str(tmp_path / "folder"), "--out", str(tmp_path / "a.csv")]) == 0
    assert [int(row[0]) for row in read_table(tmp_path / "a.csv")[1]] == [START_NS, START_NS + 1, START_NS + 2]


def refusal(arguments, capsys):
    """Return the one-line error of export."""
    assert main([str(argument) for argument in arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


@pytest.fixture
def imu_bag(tmp_path):
    return write_imu_bag(tmp_path / "imu.mcap", 20)


def test_a_missing_topic_is_reported_with_the_most_similar_one(imu_bag, tmp_path, capsys):
    line = refusal([imu_bag, "--out", tmp_path / "out", "--topics", "ins/imv"], capsys)
    assert line.endswith("imu.mcap: no topic 'ins/imv': did you mean 'ins/imu'?")
    assert not (tmp_path / "out").exists()


def test_a_truth_topic_is_not_suggested_for_a_ship_topic(tmp_path, capsys):
    """A user who follows the suggestion would evaluate the truth itself."""
    demo, options = ROOT / "bags" / "demo.mcap", ["--out", tmp_path / "out", "--topics"]
    for name in ("ship/attitude", "attitude", "ship/atitude"):
        line = refusal([demo, *options, name], capsys)
        assert "did you mean" not in line
        assert ": it has gnss/fix, ins/imu, met/humidity, " in line
        assert line.endswith("star/starboard/horizon_attitude, truth/alignment, truth/attitude")
    assert refusal([demo, *options, "truth/atitude"], capsys).endswith("did you mean 'truth/attitude'?")
    with BagWriter(tmp_path / "both.mcap") as bag:
        for topic in ("/a/truth/attitude", "/a/ship/attitude"):
            bag.write(topic, imu(START_NS), START_NS)
    line = refusal([tmp_path / "both.mcap", *options, "/a/trip/attitude"], capsys)
    assert line.endswith("did you mean 'a/ship/attitude'?")


def test_the_slash_in_front_of_a_topic_may_be_there_or_not(imu_bag, tmp_path):
    assert main([str(imu_bag), "--out", str(tmp_path / "a.csv"), "--topics", "/ins/imu"]) == 0


def test_existing_files_are_overwritten_only_with_force(imu_bag, tmp_path, capsys):
    out = tmp_path / "a.csv"
    out.write_text("precious")
    assert "already exists: use --force to overwrite" in refusal([imu_bag, "--out", out], capsys)
    assert out.read_text() == "precious"
    assert main([str(imu_bag), "--out", str(out), "--force"]) == 0
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "ins.imu.csv").write_text("precious")
    assert "ins.imu.csv: already exists" in refusal([imu_bag, "--out", tmp_path / "folder"], capsys)


def test_one_file_cannot_take_two_topics(tmp_path, capsys):
    line = refusal([ROOT / "bags" / "demo.mcap", "--out", tmp_path / "a.csv"], capsys)
    assert "9 topics are exported" in line


def test_format_and_name_must_agree(imu_bag, tmp_path, capsys):
    line = refusal([imu_bag, "--out", tmp_path / "a.csv", "--format", "netcdf"], capsys)
    assert "--out ends in .csv, but --format is netcdf" in line


def test_an_empty_out_is_no_folder(imu_bag, tmp_path, capsys, monkeypatch):
    """An empty --out results from an unset variable, and would mean the current folder."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main([str(imu_bag), "--out", ""])
    assert left.value.code == 2
    assert "argument --out: it is empty: name a folder, or a file .csv, .parquet or .nc" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["imu.mcap"]


@pytest.mark.parametrize("name", ["x.xls", "a.csv.gz", "night.2"])
def test_an_unknown_suffix_is_refused_unless_it_is_a_folder(name, imu_bag, tmp_path, capsys):
    line = refusal([imu_bag, "--out", tmp_path / name], capsys)
    ending = Path(name).suffix
    assert f"{name}: --out ends in {ending}: a file ends in one of .csv, .parquet, .nc; a folder of that name" in line
    assert not (tmp_path / name).exists()
    (tmp_path / name).mkdir()
    assert main([str(imu_bag), "--out", str(tmp_path / name)]) == 0
    assert [path.name for path in (tmp_path / name).iterdir()] == ["ins.imu.csv"]


@pytest.mark.parametrize("suffix", SUFFIXES.values())
def test_a_suffix_in_capital_letters(suffix, imu_bag, tmp_path):
    path = tmp_path / f"A{suffix.upper()}"
    assert main([str(imu_bag), "--out", str(path)]) == 0
    assert path.is_file()
    assert len(read_table(path.rename(tmp_path / f"a{suffix}"))[1]) == 20


def test_two_topics_that_map_to_one_name_are_refused(tmp_path, capsys):
    path = tmp_path / "two.mcap"
    with BagWriter(path) as bag:
        bag.write("/a/b", imu(START_NS), START_NS)
        bag.write("A.b", imu(START_NS), START_NS)
    line = refusal([path, "--out", tmp_path / "out"], capsys)
    assert "topics '/a/b' and 'A.b' would both be written" in line or "topics 'A.b' and '/a/b' would both" in line
    assert main([str(path), "--out", str(tmp_path / "out"), "--topics", "/a/b"]) == 0


def test_a_hostile_name_of_a_topic_stays_in_the_folder(tmp_path):
    path = tmp_path / "hostile.mcap"
    with BagWriter(path) as bag:
        bag.write("../../etc/passwd\n", imu(START_NS), START_NS)
    assert main([str(path), "--out", str(tmp_path / "out")]) == 0
    assert [made.name for made in (tmp_path / "out").iterdir()] == ["etc.passwd_.csv"]


def unknown_schema_bag(path):
    """Return a bag with ins/imu, and a topic of an unknown type without definition."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="test")
        text = definition("sensor_msgs/msg/Imu").encode()
        imu_schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", text)
        known = writer.register_channel("ins/imu", "cdr", imu_schema)
        other = writer.register_schema("acme_msgs/msg/Secret", "ros2msg", b"")
        unknown = writer.register_channel("acme", "cdr", other)
        writer.add_message(known, START_NS, serialize(imu(START_NS)), START_NS)
        writer.add_message(unknown, START_NS, b"\0\1\0\0\1", START_NS)
        writer.finish()
    return path


def test_a_topic_without_definition_is_skipped_and_refused_if_requested(tmp_path, capsys):
    path = unknown_schema_bag(tmp_path / "secret.mcap")
    assert main([str(path), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    assert "topic 'acme' is skipped: the definition of acme_msgs/msg/Secret is not in the bag" in printed.err
    assert [made.name for made in (tmp_path / "out").iterdir()] == ["ins.imu.csv"]
    line = refusal([path, "--out", tmp_path / "other", "--topics", "acme"], capsys)
    assert "topic 'acme' cannot be exported: the definition of acme_msgs/msg/Secret is not in the bag" in line


def test_a_truncated_bag_is_exported_up_to_its_end_with_a_report(tmp_path, capsys):
    whole = (ROOT / "bags" / "demo.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    assert main([str(tmp_path / "cut.mcap"), "--topics", "ins/imu", "--out", str(tmp_path / "a.csv")]) == 0
    assert "no footer, it ends or is damaged at byte" in capsys.readouterr().err
    _, rows = read_table(tmp_path / "a.csv")
    with read_bag(tmp_path / "cut.mcap") as bag:
        assert len(rows) == sum(1 for _ in bag.records(["ins/imu"])) > 1000


def test_messages_that_cannot_be_decoded_are_counted_and_named(tmp_path, capsys):
    with BagWriter(tmp_path / "bad.mcap") as bag:
        for number, data in enumerate([serialize(imu(START_NS)), b"\0\1\0\0\7", b"\0\1\0\0\7"]):
            bag.write_raw("ins/imu", "sensor_msgs/msg/Imu", data, START_NS + number)
    assert main([str(tmp_path / "bad.mcap"), "--out", str(tmp_path / "a.csv")]) == 0
    assert "topic 'ins/imu': 2 messages cannot be decoded and are left out; the first:" in capsys.readouterr().err
    assert len(read_table(tmp_path / "a.csv")[1]) == 1


def test_without_pyarrow_one_line_gives_the_remedy(imu_bag, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    line = refusal([imu_bag, "--out", tmp_path / "a.parquet"], capsys)
    assert "pip install pyarrow" in line


def test_a_text_too_long_for_netcdf_is_refused_by_name(tmp_path, capsys):
    with BagWriter(tmp_path / "text.mcap") as bag:
        bag.write("note", message_store().types["std_msgs/msg/String"]("x" * 40_000), START_NS)
    line = refusal([tmp_path / "text.mcap", "--out", tmp_path / "a.nc"], capsys)
    assert "topic 'note': a data of 40000 bytes" in line
    assert [path.name for path in tmp_path.iterdir()] == ["text.mcap"]
    assert main([str(tmp_path / "text.mcap"), "--out", str(tmp_path / "a.csv")]) == 0


@pytest.mark.parametrize("kind", SUFFIXES)
def test_a_full_disk_is_named_and_nothing_is_left(kind, tmp_path, capsys, small_files):
    write_imu_bag(tmp_path / "long.mcap", 3500)
    before = sorted(path.name for path in tmp_path.iterdir())
    out = tmp_path / "out"
    with small_files(100_000):
        line = refusal([tmp_path / "long.mcap", "--out", out, "--format", kind], capsys)
    assert f"ins.imu{SUFFIXES[kind]}: File too large" in line
    assert sorted(path.name for path in tmp_path.iterdir()) == before


@pytest.mark.parametrize("kind", SUFFIXES)
def test_a_disk_that_is_full_at_the_last_table_leaves_the_old_ones_of_all(kind, tmp_path, capsys, small_files):
    """Table b alone reaches the limits: Parquet writes rows at the end, and NetCDF's longest text comes last."""
    string = message_store().types["std_msgs/msg/String"]
    with BagWriter(tmp_path / "texts.mcap") as bag:
        bag.write("a", string("first"), START_NS)
        for number in range(1000):
            bag.write("b", string(f"{number:064x}"), START_NS)
        bag.write("b", string("x" * 2000), START_NS)
    out = tmp_path / "out"
    out.mkdir()
    old = {f"{name}{SUFFIXES[kind]}": f"old {name}" for name in "ab"}
    for name, text in old.items():
        (out / name).write_text(text)
    with small_files({"csv": 50_000, "parquet": 5_000, "netcdf": 150_000}[kind]):
        line = refusal([tmp_path / "texts.mcap", "--out", out, "--format", kind, "--force"], capsys)
    assert f"b{SUFFIXES[kind]}: File too large" in line
    assert {path.name: path.read_text() for path in out.iterdir()} == old


@pytest.fixture
def small_files():
    """Limit the length of files, which fails like a full disk in the middle of the content."""

    @contextmanager
    def bound(length):
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (length, hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
            signal.signal(signal.SIGXFSZ, before)

    return bound


def write_defined(path, text, data, topic="odd", name="x/msg/A"):
    """Write one message of a type that is defined only in the bag."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(name, "ros2msg", text.encode())
        writer.add_message(writer.register_channel(topic, "cdr", schema), START_NS, b"\0\1\0\0" + data, START_NS)
        writer.finish()
    return path


RULE = "\n" + "=" * 80 + "\n"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("x/A[] a", "more than 100 tables"),
        ("x/A a", "messages within messages are more than 16 deep"),
        # Each type has ten fields of the next type, 14 levels deep; the last type is empty.
        (
            "".join(f"x/B1 f{i}\n" for i in range(10))
            + "".join(
                f"{RULE}MSG: x/msg/B{level}\n" + "".join(f"x/B{level + 1} f{i}\n" for i in range(10))
                for level in range(1, 14)
            )
            + f"{RULE}MSG: x/msg/B14\n",
            "more than 2000 columns",
        ),
    ],
    ids=["arrays of itself", "itself", "many times nothing"],
)
def test_a_definition_without_end_is_refused_at_once(text, why, tmp_path, capsys):
    path = write_defined(tmp_path / "endless.mcap", text, b"\0" * 64)
    assert why in refusal([path, "--out", tmp_path / "out"], capsys)
    assert not (tmp_path / "out").exists()


def test_arrays_of_the_same_name_within_one_another_have_two_indices(tmp_path):
    text = f"x/B[] values{RULE}MSG: x/msg/B\nint32[] values\n"
    data = struct.pack("<2I2i1Ii", 2, 2, 5, 6, 1, 7)
    assert main([str(write_defined(tmp_path / "a.mcap", text, data)), "--out", str(tmp_path / "out")]) == 0
    names, rows = read_table(tmp_path / "out" / "odd-values-values.csv")
    assert names[1:] == ["message_index", "values_index", "values_index_2", "values"]
    assert [row[1:] for row in rows] == [["0", "0", "0", "5"], ["0", "0", "1", "6"], ["0", "1", "0", "7"]]


def test_arrays_whose_places_read_the_same_have_two_tables(tmp_path):
    text = f"int32[] b_c\nx/B b{RULE}MSG: x/msg/B\nint32[] c\n"
    data = struct.pack("<IiIi", 1, 5, 1, 6)
    assert main([str(write_defined(tmp_path / "a.mcap", text, data)), "--out", str(tmp_path / "out")]) == 0
    found = {path.name: read_table(path)[1][0][-1] for path in (tmp_path / "out").glob("odd-*")}
    assert found == {"odd-b_c.csv": "5", "odd-b_c_2.csv": "6"}


@pytest.mark.parametrize("kind", SUFFIXES)
def test_fields_named_like_columns_get_unique_names(kind, tmp_path):
    text = "float64 time\nint64 stamp_ns\nint32 log_time_ns\nint32 stamp_ns_remainder\nint32 a_count\nint32[] a"
    data = struct.pack("<dqiiiI2i", 0.5, 2**62 + 1, 7, 8, 9, 2, 10, 11)
    path = write_defined(tmp_path / "odd.mcap", text, data)
    assert main([str(path), "--out", str(tmp_path / "out"), "--format", kind]) == 0
    suffix = SUFFIXES[kind]
    if kind == "netcdf":
        with netcdf_file(tmp_path / "out" / "odd.nc", mmap=False) as file:
            found = {name: values(variable)[0] for name, variable in file.variables.items()}
        assert int(found["stamp_ns"]) + found["stamp_ns_remainder_"] == 2**62 + 1
        assert (found["time_2"], found["stamp_ns_remainder"], found["log_time_ns_2"]) == (0.5, 8, 7)
    else:
        names, ((*row,),) = read_table(tmp_path / "out" / f"odd{suffix}")
        assert names[2:] == ["time_2", "stamp_ns", "log_time_ns_2", "stamp_ns_remainder", "a_count", "a_count_2"]
        assert list(map(float, row[2:])) == [0.5, 2.0**62, 7, 8, 9, 2]
    names, rows = read_table(tmp_path / "out" / f"odd-a{suffix}")
    assert [int(row[names.index("a")]) for row in rows] == [10, 11]


def test_too_many_open_files_are_reported(tmp_path, capsys):
    with BagWriter(tmp_path / "many.mcap") as bag:
        for number in range(60):
            bag.add_topic(f"t{number}", "std_msgs/msg/Float64")
        bag.write("t0", message_store().types["std_msgs/msg/Float64"](1.0), START_NS)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    there = len(list(Path("/proc/self/fd").iterdir()))
    resource.setrlimit(resource.RLIMIT_NOFILE, (there + 20, hard))
    try:
        line = refusal([tmp_path / "many.mcap", "--out", tmp_path / "out"], capsys)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert "too many files at once: export fewer topics by --topics" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_ctrl_c_leaves_nothing_behind(tmp_path):
    write_imu_bag(tmp_path / "long.mcap", 30_000)
    options = [str(tmp_path / "long.mcap"), "--out", str(tmp_path / "out")]
    # The command has a low priority, so that on a busy computer it does not end before this test sends the signal.
    # The default signal handler is needed if the tests run in the background of a shell.
    patient = ["env", "--default-signal=INT", "nice", "-n", "19"]
    command = [*patient, sys.executable, "-m", "ship_bags.commands.export", *options]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    while not any(path.stat().st_size for path in tmp_path.glob("out/*.part")):
        assert process.poll() is None
        time.sleep(0.002)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (130, "export: interrupted\n")
    assert [path.name for path in tmp_path.iterdir()] == ["long.mcap"]


def test_a_definition_that_would_make_endless_columns_is_refused(tmp_path, capsys):
    text = "x/B[64] b\n" + "=" * 80 + "\nMSG: x/msg/B\nx/C[64] c\n" + "=" * 80 + "\nMSG: x/msg/C\nfloat64 d\n"
    write_defined(tmp_path / "wide.mcap", text, struct.pack("<4096d", *range(4096)), "wide")
    line = refusal([tmp_path / "wide.mcap", "--out", tmp_path / "out"], capsys)
    assert "topic 'wide' (x/msg/A) cannot become a table" in line
    assert "more than 2000 columns" in line
