"""``suite``: start the nodes of a suite file, each as a separate process, with one command.

Without a start it reports the expected availability at the suite's limits, from a recording that is replayed through
the nodes of the suite.
"""

import argparse
import math
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, launcher, run_command
from ship_bags.errors import BadInput, one_line
from ship_bags.live.ros_process import (
    dds_has_security,
    loaded_libraries,
    namespace_name,
    positive_number,
    require_security,
)
from ship_bags.mcap.bag_reader import read_bag, with_bag_progress
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.topic_names import TRUTH_PREFIX, add_remap_option
from ship_bringup.security.demand import require_profile
from ship_bringup.suite.plan import SuiteOptions, make_plan
from ship_bringup.suite.supervisor import FROZEN_REPORT_S, FROZEN_RESTART_S, SuiteLog, Supervisor, log_path
from ship_replay.offline.adapter_chain import suite_text
from ship_replay.offline.replay import ADAPTERS, replay
from ship_watch.safety.availability import REQUIRED_SHARE, START_UP_S, Availability, AvailabilityRecord
from ship_watch.safety.functions import QUANTITIES
from ship_watch.safety.limits import Limits, read_limits
from ship_watch.topics import monitored_topic

_DESCRIPTION = """\
Starts a node for each section of a suite file (ROS 2 parameter file with sections as '/**/ship_attitude:'), each as a
process of its own, and prints their lines with the node's name as prefix. A node that ends is started again, at once
the first time, then after 1 s, 2 s, 4 s and so on, up to 30 s, without limit; it starts from the alignment that it
saved (parameters alignment_file and alignment_autosave_s). A node that sends no heartbeat is frozen: it is reported,
and later killed and started again. The suite ends by itself only if no node has run yet and each has ended with exit
code 2, bad input. Ctrl-C, SIGTERM or SIGHUP ends all in order, a second one at once; if this process is killed, they
end too. With --bag the bag is played into the nodes and sets their time; the suite ends with it. Topics that the nodes
publish themselves are not played.

While stdout accepts no lines (no reader, disk full), they are written to suite.log, or suite_NAMESPACE.log, in the
folder of ROS's logs (ROS_LOG_DIR, else ~/.ros/log): 5 MB and the 5 MB before.

Sections for nmea_in and nmea_out, as '/**/nmea_out:', start these nodes of ship_nmea, too: attitude and alerts are sent
as NMEA sentences, and instruments' sentences become topics, but not with --bag. The others do not need them.
"""
_NO_FILE = Path()
"""Value of the option ``--limits`` without a file."""

_EPILOG = (
    "exit code: 0 ended by Ctrl-C, SIGTERM, SIGHUP or the end of the bag while all programs ran; otherwise that of\n"
    "the player, or of the first program that was down at the end (128 + n after signal n); 2 bad input or usage"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``suite``; return the exit code."""
    return run_command(_parser(), _suite, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_bringup",
        prog="suite",
        example="examples/two_sensors.yaml --bag bags/demo.mcap",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "file", type=Path, nargs="?", metavar="FILE", help="suite file; without: the one attached to the bag"
    )
    parser.add_argument(
        "--namespace", type=namespace_name, default="", metavar="NS", help="namespace of all nodes and topics (none)"
    )
    parser.add_argument("--bag", type=Path, metavar="BAG", help="play this bag into the nodes")
    add_remap_option(parser)
    parser.add_argument(
        "--rate", type=positive_number, default=1.0, metavar="R", help="with --bag: seconds of the bag per second (1)"
    )
    parser.add_argument(
        "--loop", type=_count, default=1, metavar="N", help="with --bag: play it N times, 0 without end (1)"
    )
    parser.add_argument("--use-sim-time", action="store_true", help="the nodes follow /clock of another program")
    parser.add_argument(
        "--reliable-inputs",
        action="store_true",
        help="for a link that loses packets: lost messages to the nodes' inputs are sent again",
    )
    parser.add_argument("--monitor", action="store_true", help="also start live page and alerts of ship_monitor")
    parser.add_argument(
        "--limits",
        type=Path,
        nargs="?",
        const=_NO_FILE,
        metavar="FILE",
        help="the ship's limits, for page and alerts; if they require DDS security, nothing starts without it; "
        "without FILE: --dry-run with the default limits",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="start nothing: replay --bag, print the share of time within the limits, and propose limits",
    )
    parser.add_argument(
        "--port", type=_port, metavar="PORT", help="with --monitor: port of the page (default as for 'monitor')"
    )
    parser.add_argument("--box", type=Path, metavar="FOLDER", help="folder for a black box of each node")
    parser.add_argument(
        "--frozen-report",
        type=positive_number,
        default=FROZEN_REPORT_S,
        metavar="S",
        help=f"report a program that has sent no heartbeat for S seconds ({FROZEN_REPORT_S:.0f})",
    )
    parser.add_argument(
        "--frozen-restart",
        type=positive_number,
        default=FROZEN_RESTART_S,
        metavar="S",
        help=f"kill a program without heartbeat for S seconds, and start it again ({FROZEN_RESTART_S:.0f})",
    )
    return parser


def _suite(parsed: argparse.Namespace) -> int:
    if parsed.file is None and parsed.bag is None:
        raise BadInput("no FILE: expected a suite file, or --bag with a bag that has one attached")
    if parsed.dry_run or parsed.limits is _NO_FILE:
        return _show_limits(parsed)
    require_security()
    if parsed.limits is not None:
        require_profile(read_limits(parsed.limits), parsed.limits, dds_has_security(loaded_libraries()))
    options = SuiteOptions(
        namespace=parsed.namespace,
        bag=parsed.bag,
        rate=parsed.rate,
        loop=parsed.loop,
        monitor=parsed.monitor,
        box=parsed.box,
        reliable_inputs=parsed.reliable_inputs,
        use_sim_time=parsed.use_sim_time,
        limits=parsed.limits,
        monitor_arguments=() if parsed.port is None else ("--port", str(parsed.port)),
    )
    with tempfile.TemporaryDirectory(prefix="ship_suite_") as folder:
        path = parsed.file or _write_attached_suite(parsed.bag, Path(folder))
        try:
            programs, warnings = make_plan(path, options)
        except BadInput as problem:
            raise BadInput(_with_bag_name(str(problem), path, parsed)) from problem
        if parsed.box is not None:
            _make_folder(parsed.box)
        log_file = log_path(parsed.namespace)
        errors, log = SuiteLog(log_file, sys.stderr.fileno()), SuiteLog(log_file, sys.stdout.fileno())
        for warning in warnings:
            errors.write(f"suite: warning: {one_line(_with_bag_name(warning, path, parsed))}")
        log.write(f"[suite] starts {', '.join(program.name for program in programs)}")
        return Supervisor(programs, log.write, parsed.frozen_report, parsed.frozen_restart).run()


def _show_limits(parsed: argparse.Namespace) -> int:
    """Print expected availability and proposed limits, without starting a node."""
    if parsed.bag is None:
        raise BadInput(
            "limits need --bag BAG: the expected accuracy is that of a recording replayed through the suite; without "
            f"a recording, simulate a voyage ({launcher()} ship_simulation simulate)"
        )
    limits = Limits() if parsed.limits in (None, _NO_FILE) else read_limits(parsed.limits)
    print("\n".join(expected_limits(parsed.file, parsed.bag, parsed.namespace, limits)))
    return EXIT_DONE


def _make_folder(box: Path) -> None:
    """Create the folder of the black boxes if it does not exist.

    Raises:
        BadInput: the folder cannot be created or is not writable.
    """
    try:
        box.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=box):
            pass
    except OSError as problem:
        raise BadInput(f"--box {box}: {problem.strerror}: expected a folder that can be written") from problem


def _write_attached_suite(bag: Path, folder: Path) -> Path:
    """Write the suite file attached to a bag, for the nodes to read; return its path.

    Raises:
        BadInput: the bag cannot be read, or has no attached suite file.
    """
    path = folder / SUITE_ATTACHMENT
    with read_bag(bag) as opened:
        path.write_text(suite_text(opened, None), encoding="utf-8")
    return path


def _with_bag_name(text: str, path: Path, parsed: argparse.Namespace) -> str:
    """Return a message in which the bag replaces the temporary path of its attached suite file."""
    return text if parsed.file is not None else text.replace(str(path), f"{parsed.bag}, attached {SUITE_ATTACHMENT}")


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is not a number of times, zero or more")
    return value


def _port(text: str) -> int:
    value = int(text)
    if not 0 < value < 65536:
        raise argparse.ArgumentTypeError(f"{text} is not a port: expected 1 to 65535")
    return value


def expected_limits(suite_file: Path | None, bag: Path, namespace: str, limits: Limits) -> list[str]:
    """Return lines of text: expected availability for each limit, proposed limits, and how to adopt them.

    Args:
        suite_file: path of the suite file; None for the file attached to the bag.
        bag: recording of the suite's inputs.
        namespace: namespace of the ship in the bag.
        limits: limits of the ship.

    Raises:
        BadInput: bag or suite file cannot be used, or the outputs are not sufficient to propose a limit.
    """
    record = AvailabilityRecord(limits)
    with tempfile.TemporaryDirectory(prefix="ship_limits_") as folder:
        outputs = Path(folder) / "outputs.mcap"
        summary = replay(bag, outputs, ADAPTERS, suite_file, namespace, with_bag_progress)
        with read_bag(outputs) as replayed:
            topics = {
                name
                for name, kind in replayed.topics.items()
                if monitored_topic(name, kind) and not name.startswith(TRUTH_PREFIX)
            }
            for each in with_bag_progress(replayed.records(topics), replayed):
                record.process_message(each.topic, each.decode(), each.log_time_ns)
    found = [one for one in map(record.availability, QUANTITIES) if one is not None]
    if not found:
        reason = f"no limit can be proposed: after the first {START_UP_S:.0f} s no quantity is SAFE with any limit"
        raise BadInput(reason, file=bag)
    return [
        f"{summary.duration_s:.0f} s of {bag} through the nodes of this suite, without the first {START_UP_S:.0f} s:",
        "",
        *_table(found),
        "",
        *_explanation(found),
        "",
        "Nothing is adopted. To adopt proposed limits, or those of your task, write them into a file for --limits:",
        "",
        *(f"{one.quantity}_arcsec: {one.proposed_arcsec}" for one in found),
    ]


def _table(found: Sequence[Availability]) -> Iterator[str]:
    yield f"{'':10}{'±95 %, median':>14}{'limit':>9}{'SAFE':>9}{'proposed':>11}{'SAFE':>9}"
    for one in found:
        limit, proposed = f"{one.limit_arcsec:g}″", f"{one.proposed_arcsec:g}″"
        shares = (f"{_percent(share):>9}" for share in (one.share, one.proposed_share))
        yield f"{one.quantity:10}{one.median_arcsec:13.1f}″{limit:>9}{next(shares)}{proposed:>11}{next(shares)}"


def _explanation(found: Sequence[Availability]) -> Iterator[str]:
    yield "SAFE: share of time in which the quantity is SAFE. Only the time counts in which the limit alone decides."
    yield f"proposed: the lowest round limit with which this is SAFE for {_percent(REQUIRED_SHARE)} of that time."
    for one in found:
        if one.other:
            first, share = next(iter(one.other.items()))
            yield (
                f"{one.quantity}: not SAFE for {_percent(1.0 - one.decisive_share)} of the time, whatever the limit. "
                f"Most frequent reason ({_percent(share)} of the time): {first}."
            )
    yield "The accuracies are those that the filters publish. In another sea, sky or suite they differ."


def _percent(share: float) -> str:
    """Return a share in percent, rounded down, so that 100 % means always."""
    return f"{math.floor(share * 100.0 + 1e-9)} %"


if __name__ == "__main__":
    raise SystemExit(main())
