"""``evaluate``: errors, covariance and innovations of a run, as tables, JSON and a figure, checked against bounds."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.output_files import add_force_option, check_file, write_atomically
from ship_bags.topic_names import add_bag_name_options
from ship_node.pages.console_tables import table_console
from ship_replay.evaluation.bounds import Bounds, check_bounds, read_bounds
from ship_replay.evaluation.evaluate import Evaluation, evaluate
from ship_replay.evaluation.tables import print_evaluation


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_replay",
        prog="evaluate",
        example="out.mcap --against bags/demo.mcap --bounds bags/demo.expected.yaml",
        epilog="exit code: 0 evaluated, all bounds met; 1 a bound is not met; 2 bad input or usage; 130 interrupted",
        description="Evaluate a run: with truth, RMS, bias, predicted sigma [arcsec] and NEES by source; always "
        "innovations [arcsec] by source and the last alignment. Exit code 1 if a bound is not met.",
    )
    parser.add_argument("bag", type=Path, metavar="OUT.mcap", help="bag with the node's outputs, or rosbag2 folder")
    parser.add_argument(
        "--against", type=Path, metavar="TRUTH.mcap", help="bag with truth and inputs, if OUT.mcap has none"
    )
    parser.add_argument(
        "--bounds",
        type=Path,
        metavar="FILE.yaml",
        help="bounds to meet: 'quantity: {min: .., max: ..}' (bags/README.md)",
    )
    parser.add_argument("--skip", type=float, metavar="S", help="exclude the first S seconds (default: 0)")
    add_bag_name_options(parser, "of the ship's topics in the bags")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all quantities (flat, units in the names)")
    parser.add_argument(
        "--figure", type=Path, metavar="FILE.png", help="draw the errors [arcsec] with their ±3σ (.png, .pdf, .svg)"
    )
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    for path in filter(None, (options.json, options.figure)):
        check_file(path, options.force)
    bounds = Bounds(0.0, {}) if options.bounds is None else read_bounds(options.bounds)
    skip_s = bounds.skip_s if options.skip is None else options.skip
    evaluation = evaluate(options.bag, options.against, skip_s, options.namespace)
    print_evaluation(evaluation, table_console())
    for problem in evaluation.problems:
        print(f"warning: {problem}")
    if options.json is not None:
        write_atomically(options.json, evaluation.json_text())
    if options.figure is not None:
        _draw(evaluation, options.bag.name, options.figure)
    checks = check_bounds(evaluation.quantities(), bounds, str(options.bounds))
    for bound in checks:
        print(bound.line)
    return EXIT_DONE if all(bound.is_met for bound in checks) else EXIT_BOUND_NOT_MET


def _draw(evaluation: Evaluation, title: str, path: Path) -> None:
    # Importing the figure libraries is slow.
    from ship_node.pages.figure_files import save_figure
    from ship_replay.evaluation.figures import evaluation_figure

    save_figure(evaluation_figure(evaluation, title), path)
