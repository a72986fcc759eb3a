"""``identify_noise``: parameters of the INS's error model for ``ship_attitude``, from a bag with stars."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import with_bag_progress
from ship_bags.output_files import add_force_option, check_file, write_atomically
from ship_bags.renamed_topics import add_bag_name_options
from ship_studies.ins_noise.identification import identify
from ship_studies.ins_noise.parameter_output import parameter_file_text, result_lines
from ship_studies.ins_noise.session import run_session


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_studies",
        prog="identify_noise",
        example="night.mcap --out noise.yaml",
        epilog="exit code: 0 identified, with or without warnings; 2 bad input or usage, with a one-line reason; 130 "
        "interrupted",
        description="Identify the error model of the INS from a bag with ins/imu, star sensors and, for the model "
        "schuler, gnss/fix: white noise, Gauss-Markov or Schuler, by maximum likelihood over the innovations of the "
        "star attitudes. Prints which model fits, the uncertainty of each parameter [1 sigma], and where predictions "
        "over parts of the record without stars were worse than predicted.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help=".mcap file or rosbag2 folder")
    parser.add_argument(
        "--config", type=Path, metavar="SUITE", help="suite configuration (default: suite.yaml attached to the bag)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE.yaml", help="parameter file to write: section ins of ship_attitude"
    )
    add_bag_name_options(parser)
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.out is not None:
        if options.out.resolve() == options.bag.resolve():
            raise BadInput("the output would overwrite the input", file=options.out)
        check_file(options.out, options.force)
    identification = identify(run_session(options.bag, options.config, options.namespace, progress=with_bag_progress))
    sys.stdout.writelines(f"{line}\n" for line in result_lines(identification))
    sys.stdout.writelines(f"warning: {line}\n" for line in identification.warnings)
    if options.out is not None:
        write_atomically(options.out, parameter_file_text(identification))
        sys.stdout.write(f"parameters: {options.out}\n")
    return EXIT_DONE
