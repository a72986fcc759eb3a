"""``import_nmea``: ship logs → bag."""

import argparse
import math
import re
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.nmea.import_nmea import GYRO_NAME, RECEIVE_TIME, ImportRequest, LogRules, import_logs
from ship_bags.nmea.instrument import INSTRUMENT_TIME
from ship_bags.nmea.instrument_lines import OPTIONAL, REQUIRED, is_talker
from ship_bags.output_files import add_force_option, check_file

_HIGHEST_RATE_HZ = 1000.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_bags",
        prog="import_nmea",
        example="--ins seapath.log --out voyage.mcap --resample 20",
        epilog="exit code: 0 written; 2 bad input or usage, with one line of reason; 130 interrupted",
        description="Turn ship logs (lines 'RECEIVE_TIME SENTENCE': GGA, ZDA, HDT, THS, PSXN 20 and 23, PASHR, PRDID, "
        "PTNTHPR, PSAT,HPR, ROT, MDA, XDR, MET) into a bag with ins/imu, reference/<name>/imu, gnss/fix and met/*. Log "
        "time is the receive time.",
    )
    parser.add_argument("--ins", type=Path, required=True, metavar="FILE", help="log of the system taken as the INS")
    parser.add_argument(
        "--reference",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="log of another attitude system (any number of times)",
    )
    parser.add_argument("--weather", type=Path, metavar="FILE", help="log with MET, MDA or XDR")
    parser.add_argument(
        "--gyro", type=Path, metavar="FILE", help=f"log with HDT or THS, becomes reference/{GYRO_NAME}/imu"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="BAG.mcap", help="bag to write")
    parser.add_argument(
        "--time",
        choices=(INSTRUMENT_TIME, RECEIVE_TIME),
        default=INSTRUMENT_TIME,
        help="stamp attitudes and fixes by the instrument's own time (ZDA) or by the receive time "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--talker",
        action="append",
        default=[],
        metavar="XX",
        help="use only sentences of this talker, as GP (any number of times); proprietary sentences have no talker",
    )
    parser.add_argument(
        "--checksum",
        choices=(REQUIRED, OPTIONAL),
        default=REQUIRED,
        help="optional: use sentences without a checksum if they have all fields (default: %(default)s)",
    )
    parser.add_argument(
        "--quality-9-is-fix",
        action="store_true",
        help="take a GGA of quality 9 as a fix with SBAS, as some manufacturers define it (default: no fix)",
    )
    parser.add_argument(
        "--resample", type=float, metavar="HZ", help="resample ins/imu by a rotation spline, with angular velocity [Hz]"
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="suite configuration to attach to the bag")
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    check_file(options.out, options.force)
    rate_hz = options.resample
    if rate_hz is not None and not (math.isfinite(rate_hz) and 0.0 < rate_hz <= _HIGHEST_RATE_HZ):
        raise BadInput(f"--resample {rate_hz:g}: expected a rate above 0 and up to {_HIGHEST_RATE_HZ:g} Hz")
    order = ImportRequest(
        ins=options.ins,
        references=_references(options.reference),
        weather=options.weather,
        gyro=options.gyro,
        time=options.time,
        resample_hz=rate_hz,
        suite=options.config,
        rules=LogRules(options.checksum == REQUIRED, _talkers(options.talker)),
        quality_9_is_fix=options.quality_9_is_fix,
    )
    for report in import_logs(order, options.out):
        print(report.text())
    return EXIT_DONE


def _talkers(texts: Sequence[str]) -> frozenset[str]:
    for text in texts:
        if not is_talker(text):
            raise BadInput(f"--talker {text}: expected two capital letters, as GP")
    return frozenset(texts)


def _references(texts: Sequence[str]) -> dict[str, Path]:
    references: dict[str, Path] = {}
    for text in texts:
        name, separator, path = text.partition("=")
        # The name becomes part of a topic's name.
        if not separator or not path or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise BadInput(f"--reference {text}: expected NAME=FILE with a name of letters, digits and _")
        if name in references:
            raise BadInput(f"--reference {text}: the name '{name}' is given twice")
        references[name] = Path(path)
    return references
