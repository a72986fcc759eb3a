"""``export``: topics of a bag → tables.

The bag is read once in order of log time, and all tables are written meanwhile.
"""

import argparse
import difflib
import errno
import re
import sys
from collections import Counter
from collections.abc import Collection, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput, one_line
from ship_bags.export.netcdf_file import NetcdfFile, midnight_before
from ship_bags.export.table_files import CsvFile, ParquetFile, TableFile, TableHead, check_parquet
from ship_bags.export.table_rows import MessageTable, TopicRows
from ship_bags.mcap.bag_reader import Bag, read_bag, with_bag_progress
from ship_bags.output_files import add_force_option, check_file, check_folder
from ship_bags.stamps import END_OF_TIME_NS, ns_from_utc_text, utc_text
from ship_bags.topic_names import TRUTH_PREFIX, add_remap_option

_DESCRIPTION = """\
Writes topics of a bag as tables, one file each, e.g. ship.attitude.csv for ship/attitude. Numbers equal those of the
messages to the last bit. The name of a column ends with its unit, if known (heading_rad, sigma_m, covariance_rad2_0).
An array of variable length becomes a table of its own with a row per element, e.g. star.fore.observations-stars.csv;
message_index is the number of its message. log_time_ns and stamp_ns are nanoseconds since 1970 of UTC as POSIX time.
NetCDF files and docs/how-to/export.md give the meaning of numbers in columns like status.
"""
_EPILOG = "exit code: 0 written; 2 bad input or usage, or the disk failed, in one line; 130 interrupted"

FORMATS: dict[str, type[TableFile]] = {"csv": CsvFile, "parquet": ParquetFile, "netcdf": NetcdfFile}

_BATCH_ROWS = 1000
_BATCH_CELLS = 30_000
"""Numbers of rows and cells at which a table writes its batch."""

_LONGEST_STEM = 180
_MAX_NAMED = 20
_MIN_SIMILARITY, _MIN_TYPO_SIMILARITY = 0.6, 0.85
"""Minimum similarity by difflib of two similar names, and of two names that differ by a typing error."""

_NOT_IN_A_NAME = re.compile(r"[^A-Za-z0-9_.-]")


@dataclass
class _Topic:
    """Topic being exported: its rows, and the file of each of its tables."""

    rows: TopicRows
    files: list[tuple[MessageTable, TableFile]] = field(default_factory=list)

    def write(self, everything: bool = False) -> None:
        """Write the tables that have a batch of rows, or with ``everything`` all tables."""
        for table, file in self.files:
            count = table.row_count
            if count >= _BATCH_ROWS or count * len(table.columns) >= _BATCH_CELLS or (everything and count):
                file.append(table.take_columns())


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_bags",
        prog="export",
        example="bags/demo.mcap --topics ins/imu gnss/fix --format netcdf --out tables",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bag", type=Path, help="bag to read: .mcap file or rosbag2 folder")
    add_remap_option(parser)
    parser.add_argument(
        "--out",
        type=_out,
        required=True,
        metavar="OUT",
        help="folder to write into, made if it is missing; for one topic also a file .csv, .parquet or .nc; other "
        "suffixes are refused unless a folder of that name exists",
    )
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="only these topics, named as in the bag (all)"
    )
    parser.add_argument(
        "--format",
        choices=tuple(FORMATS),
        help="csv; parquet, which needs the package pyarrow; netcdf: NetCDF-3 after the CF conventions (by the name of "
        "OUT, else csv)",
    )
    parser.add_argument(
        "--from",
        dest="since",
        type=_time_ns,
        default=0,
        metavar="UTC",
        help="leave out messages logged before, e.g. 2026-06-01T20:00:30.5Z, and topics that have no others (the start "
        "of the bag)",
    )
    parser.add_argument(
        "--to",
        dest="until",
        type=_time_ns,
        default=END_OF_TIME_NS,
        metavar="UTC",
        help="leave out messages logged then and later, and topics that have no others (the end of the bag)",
    )
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    row_counts, problems = export(options)
    for line in problems:
        print(f"export: {one_line(line)}", file=sys.stderr)
    for path, rows in row_counts.items():
        print(f"export: {path}: {rows} rows")
    return EXIT_DONE


def export(options: argparse.Namespace) -> tuple[dict[Path, int], list[str]]:
    """Write the topics of a bag as tables; no table gets its final name before all tables are complete.

    Returns:
        Number of rows of each file, and one line for each omission or problem of the bag.

    Raises:
        BadInput: bag, topics or names of files cannot be used; the text gives the reason.
        OSError: a file cannot be written.
    """
    if options.since >= options.until:
        raise BadInput(f"--from {utc_text(options.since)} is not before --to {utc_text(options.until)}")
    kind = _file_kind(options)
    with read_bag(options.bag) as bag, ExitStack() as stack:
        names = _selected_topics(bag, options.topics)
        topics, refused = _topic_rows(bag, names, bool(options.topics))
        paths = _paths(options, kind, topics)
        folder = _prepare_folder(options, paths)
        if folder is not None:
            stack.callback(_remove_if_empty, folder)
        epoch_ns = midnight_before(bag.start_ns)
        for name, topic in topics.items():
            for table in topic.rows.tables:
                head = TableHead(options.bag.name, name, bag.topics[name], table.name, epoch_ns)
                file = _open_file(kind, paths[name, table.name], head, table)
                stack.callback(file.discard)
                topic.files.append((table, file))
        met, left_out = _take_messages(bag, options, topics)
        files = [file for name in met for _, file in topics[name].files]
        # No file gets its final name before all are on the disk: a full disk is detected here at the latest.
        for file in files:
            file.finish()
        for file in files:
            file.publish()
        return {file.path: file.row_count for file in files}, [*bag.problems, *refused, *left_out]


def _open_file(kind: type[TableFile], path: Path, head: TableHead, table: MessageTable) -> TableFile:
    try:
        return kind(path, head, table.columns)
    except OSError as problem:
        if problem.errno != errno.EMFILE:
            raise
        raise BadInput("too many files at once: export fewer topics by --topics", file=path) from problem


def _take_messages(bag: Bag, options: argparse.Namespace, topics: dict[str, _Topic]) -> tuple[list[str], list[str]]:
    """Read the bag and write the rows; return the topics that get files, and one line for each omission.

    Raises:
        BadInput: no message lies in the time range.
    """
    met: set[str] = set()
    counts: Counter[str] = Counter()
    first: dict[str, str] = {}
    records = takewhile(lambda record: record.log_time_ns < options.until, bag.records(topics.keys(), options.since))
    for record in with_bag_progress(records, bag):
        topic = topics[record.topic]
        met.add(record.topic)
        try:
            message = record.decode()
        except BadInput as problem:
            counts[record.topic] += 1
            first.setdefault(record.topic, str(problem))
            continue
        topic.rows.add(message, record.log_time_ns)
        topic.write()
    for topic in topics.values():
        topic.write(everything=True)
    undecoded = [
        f"topic '{name}': {number} messages cannot be decoded and are left out; the first: {first[name]}"
        for name, number in counts.items()
    ]
    if options.since == 0 and options.until == END_OF_TIME_NS:
        return list(topics), undecoded
    empty = [f"'{name}'" for name in topics if name not in met]
    if not met:
        what = "no message of these topics" if options.topics else "no message"
        bag_times = f"the bag is from {utc_text(bag.start_ns)} to {utc_text(bag.end_ns)}"
        raise BadInput(f"{what} was logged between --from and --to: {bag_times}", file=options.bag)
    nothing = "no message was logged between --from and --to, so no file is written for"
    left_out = [f"{nothing} {', '.join(empty)}"] if empty else []
    return [name for name in topics if name in met], [*undecoded, *left_out]


def _file_kind(options: argparse.Namespace) -> type[TableFile]:
    """Return the kind of file; ``--format`` and the suffix of ``--out`` must not contradict each other."""
    by_name = None
    if _names_a_file(options.out):
        suffix = options.out.suffix.lower()
        by_name = next((name for name, kind in FORMATS.items() if kind.suffix == suffix), None)
        if by_name is None:
            known = ", ".join(kind.suffix for kind in FORMATS.values())
            raise BadInput(
                f"--out ends in {options.out.suffix}: a file ends in one of {known}; a folder of that name must exist",
                file=options.out,
            )
    if options.format and by_name and options.format != by_name:
        raise BadInput(f"--out ends in {options.out.suffix}, but --format is {options.format}", file=options.out)
    name = options.format or by_name or "csv"
    if name == "parquet":
        check_parquet()
    return FORMATS[name]


def _names_a_file(out: Path) -> bool:
    """Return True if ``--out`` means a file: it has a suffix and is not a folder."""
    return bool(out.suffix) and not out.is_dir()


def _selected_topics(bag: Bag, names: Sequence[str]) -> list[str]:
    """Return the topics to export, by their names in the bag."""
    if not names:
        return sorted(bag.topics)
    bare = {name.lstrip("/"): name for name in bag.topics}
    skipped = {name.lstrip("/"): name for name in bag.skipped_topics}
    wanted = []
    for name in dict.fromkeys(name.lstrip("/") for name in names):
        if name not in bare and name in skipped:
            why = bag.skipped_topics[skipped[name]]
            raise BadInput(f"topic '{skipped[name]}' cannot be exported: {why}", file=bag.path)
        if name not in bare:
            raise BadInput(f"no topic '{name}': {_hint(name, bare)}", file=bag.path)
        wanted.append(bare[name])
    return wanted


def _hint(name: str, known: Collection[str]) -> str:
    """Return a text with the similar topic that the user may have meant; without a similar topic, list the topics.

    A truth topic of a simulation is suggested only if no other topic is similar, because truth/attitude would mislead
    for a missing ship/attitude.
    """
    truth = sorted(topic for topic in known if f"/{TRUTH_PREFIX}" in f"/{topic}")
    others = sorted(set(known).difference(truth))
    near = difflib.get_close_matches(name, others, 1, _MIN_SIMILARITY) or difflib.get_close_matches(
        name, truth, 1, _MIN_TYPO_SIMILARITY
    )
    return f"did you mean '{near[0]}'?" if near else f"it has {', '.join([*others, *truth][:_MAX_NAMED])}"


def _topic_rows(bag: Bag, names: list[str], required: bool) -> tuple[dict[str, _Topic], list[str]]:
    """Return the topics whose types can become tables, and one line for each other topic."""
    topics, refused = {}, []
    for name in names:
        try:
            topics[name] = _Topic(TopicRows(bag.topics[name], bag.store))
        except BadInput as problem:  # noqa: PERF203 - each topic by itself
            why = f"topic '{name}' ({bag.topics[name]}) cannot become a table: {problem}"
            if required:
                raise BadInput(why, file=bag.path) from problem
            refused.append(why)
    if not topics:
        skipped = [f"topic '{name}' is skipped: {why}" for name, why in sorted(bag.skipped_topics.items())]
        raise BadInput(f"no topic can be exported: {'; '.join(refused + skipped)}", file=bag.path)
    return topics, refused


def _paths(
    options: argparse.Namespace, kind: type[TableFile], topics: dict[str, _Topic]
) -> dict[tuple[str, str], Path]:
    """Return the file of each table, by topic and name of the table."""
    single = _names_a_file(options.out)
    if single and len(topics) > 1:
        raise BadInput(
            f"--out names one file, but {len(topics)} topics are exported: name one by --topics, or a folder",
            file=options.out,
        )
    paths: dict[tuple[str, str], Path] = {}
    owners: dict[str, str] = {}
    for name, topic in topics.items():
        stem = options.out.stem if single else _stem(name)
        folder = options.out.parent if single else options.out
        # The suffix is kept as the user wrote it, with its capital letters.
        suffix = options.out.suffix if single else kind.suffix
        for table in topic.rows.tables:
            path = folder / f"{stem}{'-' if table.name else ''}{table.name}{suffix}"
            # Some file systems do not distinguish capital letters.
            owner = owners.setdefault(path.name.lower(), name)
            if owner != name:
                raise BadInput(
                    f"topics '{owner}' and '{name}' would both be written to {path.name}: export them one by one with "
                    "--topics, into two folders",
                    file=options.bag,
                )
            paths[name, table.name] = path
    return paths


def _stem(topic: str) -> str:
    """Return a topic's name as a file name: ship/attitude → ship.attitude."""
    name = _NOT_IN_A_NAME.sub("_", topic.strip("/").replace("/", "."))
    return name.lstrip(".-")[:_LONGEST_STEM] or "topic"


def _prepare_folder(options: argparse.Namespace, paths: dict[tuple[str, str], Path]) -> Path | None:
    """Check that all files can be written; return the folder if it was created for them."""
    if any(path.exists() and path.resolve() == options.bag.resolve() for path in paths.values()):
        raise BadInput("the output would overwrite the bag", file=options.bag)
    if next(iter(paths.values())).parent != options.out:
        for path in paths.values():
            check_file(path, options.force)
        return None
    check_folder(options.out, [path.name for path in paths.values()], options.force)
    if options.out.exists():
        return None
    folder: Path = options.out
    folder.mkdir(parents=True)
    return folder


def _remove_if_empty(folder: Path) -> None:
    """Remove a folder that was created for files that were not written."""
    with suppress(OSError):
        folder.rmdir()


def _out(text: str) -> Path:
    # An empty path, from a variable that is not set, would mean the current folder.
    if not text.strip():
        raise argparse.ArgumentTypeError("it is empty: name a folder, or a file .csv, .parquet or .nc")
    return Path(text)


def _time_ns(text: str) -> int:
    try:
        return ns_from_utc_text(text)
    except ValueError as problem:
        raise argparse.ArgumentTypeError(str(problem)) from problem


if __name__ == "__main__":
    raise SystemExit(main())
