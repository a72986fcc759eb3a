"""``simulate``: simulate a scenario file into a bag with truth, scenario and suite configuration."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command, with_progress
from ship_bags.mcap.bag_writer import SCENARIO_ATTACHMENT, SUITE_ATTACHMENT, BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.output_files import add_force_option, check_file
from ship_estimation.parameters.schema import parameter_row, wrapped_lines
from ship_geometry.earth.time_scales import SECOND_NS
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import simulate_stretches
from ship_simulation.scenario.fault import kind_rows
from ship_simulation.scenario.scenario import Scenario, scenario_keys, start_time_ns
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite_file import suite_yaml

_DESCRIPTION = """\
Simulates a voyage: the ship's motion, INS, star sensors and other attitude systems with their errors and faults.
A star sensor gives its horizon attitude, single stars of the real sky over the ship, or its attitude against the ICRS.
A theodolite has encoders, and observes lights of drones, targets in its main tube, and stars in its cameras.
The bag contains their topics and the truth (truth/attitude and truth/pointing at 10 Hz, truth/alignment at 1 Hz, and
more). Its attachments are the scenario and the matching configuration of the suite. In a scenario the names contain
the units: _deg, _arcsec, _s, _m, _hz. The same scenario and seed give the same bytes.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    kinds = "\n".join(kind_rows())
    parser = CommandParser(
        package="ship_simulation",
        prog="simulate",
        example="bags/scenarios/demo.yaml --out demo.mcap --seed 1",
        description=_DESCRIPTION,
        epilog=f"keys of SCENARIO.yaml, nested at the dots (<id>: any name):\n{_keys()}\n\n"
        f"kinds of faults (faults.<id>.kind):\n{kinds}\n\n"
        "exit code: 0 written; 2 bad input or usage; 130 interrupted",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scenario", type=Path, metavar="SCENARIO.yaml", help="scenario to simulate")
    parser.add_argument("--out", type=Path, required=True, metavar="BAG.mcap", help="bag to write")
    parser.add_argument(
        "--seed", type=parse_seed, default=1, metavar="N", help="seed of all random parts, 0 or more (1)"
    )
    parser.add_argument(
        "--carrier", type=Path, metavar="BAG", help="follow the recorded attitude of this bag, not the scenario's"
    )
    add_force_option(parser)
    return parser


def _keys() -> str:
    return "\n".join(wrapped_lines([parameter_row(key) for key in scenario_keys()]))


def parse_seed(text: str) -> int:
    """Return the seed of an argument.

    Raises:
        ArgumentTypeError: the text is not a seed.
    """
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number, 0 or more")
    return int(text)


def _run(options: argparse.Namespace) -> int:
    check_file(options.out, options.force)
    scenario = load_scenario(options.scenario, recording=options.carrier)
    count = write_bag(scenario, options.seed, options.out, options.scenario.read_bytes())
    print(f"{options.out}: {count} messages, {scenario.duration_s:g} s, seed {options.seed}")
    return EXIT_DONE


def write_bag(scenario: Scenario, seed: int, path: Path, scenario_text: bytes) -> int:
    """Simulate a voyage into a bag; return the number of its messages.

    Raises:
        BadInput: the voyage cannot be simulated, or the file cannot be written.
    """
    runs = simulate_stretches(scenario, seed)
    start_ns = start_time_ns(scenario.start_utc)
    end_ns = start_ns + round(scenario.duration_s * SECOND_NS)
    entries = with_progress(
        generate_messages(runs, RosbagsFactory()), path.name, start_ns, end_ns, lambda entry: entry[2]
    )
    with BagWriter(path) as bag:
        bag.add_attachment(SCENARIO_ATTACHMENT, scenario_text)
        bag.add_attachment(SUITE_ATTACHMENT, suite_yaml(scenario))
        bag.add_metadata("simulation", {"seed": str(seed)})
        for topic, message, log_time_ns in entries:
            bag.write(topic, message, log_time_ns)
        return bag.message_count
