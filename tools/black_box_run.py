"""A long live run with all operations of a watch. Its black boxes are replayed and compared bit by bit.

The run has four accepted parameter changes (two of them remove and add a star sensor), a rejected change, a save, a
reset and a load. Then the node is restarted with the saved alignment.
Exit code 0 all boxes verified; 1 a black box was not verified, or a process failed; 2 bad input or usage.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import yaml
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_simulation.simulate_command import main as simulate
from ship_testing.trials.live_run import LiveFailure, LiveRun, executable

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "bags" / "scenarios" / "demo.yaml"
SERVICE_TIMEOUT_S = 20.0

Action = tuple[float, Callable[[LiveRun], None]]
"""Fraction of the run, and the action at that time."""


def main() -> int:
    """Run the nodes and verify their boxes."""
    parser = CommandParser(prog="black_box_run", description=__doc__, epilog="times are of the simulated ship")
    parser.add_argument("--minutes", type=float, default=10.0, metavar="MIN", help="length of the voyage, min (10)")
    parser.add_argument("--rate", type=float, default=1.0, metavar="R", help="seconds of the voyage per second (1)")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "black_box", help="folder of bags and boxes")
    return run_command(parser, _run, None)


def _run(options: argparse.Namespace) -> int:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    try:
        boxes = eventful_runs(options.folder, 60.0 * options.minutes, options.rate)
    except LiveFailure as failure:
        print(f"black_box_run: {failure}", file=sys.stderr)
        return EXIT_BOUND_NOT_MET
    codes = []
    for box in boxes:
        finished = verify_box(box)
        print(f"{box}\n{finished.stdout}{finished.stderr}")
        codes.append(finished.returncode)
    return EXIT_DONE if not any(codes) else EXIT_BOUND_NOT_MET


def eventful_runs(folder: Path, duration_s: float, rate: float) -> list[Path]:
    """Run the node twice over one voyage, the second time with the alignment saved by the first.

    Args:
        folder: folder of all files; black boxes of earlier runs are not removed.
        duration_s: length of the voyage, s.
        rate: seconds of the voyage per second.

    Returns:
        Paths of the black boxes of both runs.

    Raises:
        LiveFailure: a process failed, or a response of the node was not as expected.
    """
    folder.mkdir(parents=True, exist_ok=True)
    alignment_path = folder / "alignment.yaml"
    alignment_path.unlink(missing_ok=True)
    bag_path = _voyage(folder, duration_s)
    parameters = {"black_box": f"{folder}/boxes/", "alignment_file": str(alignment_path)}
    boxes = []
    for number in (1, 2):
        with LiveRun(bag_path, ShipAttitudeAdapter, "ship_attitude_star", folder / f"run_{number}", parameters) as run:
            plan = _Plan(run, duration_s / rate, _ACTIONS if number == 1 else ())
            run.play(rate, plan.run_due)
            plan.finish()
            if run.node.end() != 0:
                raise LiveFailure(run.node.log_text())
            boxes.append(_box_path(run.node.log_text()))
    return boxes


def verify_box(box: Path) -> "subprocess.CompletedProcess[str]":
    """Run ``replay --verify`` in a separate process; return its result."""
    command = [*executable("ship_replay", "replay"), str(box), "--verify"]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def call(run: LiveRun, kind: Any, name: str, request: Any) -> Any:
    """Return the response of a service of the node."""
    client = run.observer.node.create_client(kind, f"/ship_attitude/{name}")
    if not run.observer.spin_until(client.service_is_ready, SERVICE_TIMEOUT_S):
        raise LiveFailure(f"service {name} is not available")
    answer = client.call_async(request)
    if not run.observer.spin_until(answer.done, SERVICE_TIMEOUT_S):
        raise LiveFailure(f"service {name} does not respond")
    return answer.result()


def set_parameter(run: LiveRun, name: str, value: float | list[str]) -> Any:
    """Return the node's result of a live parameter change."""
    request = SetParametersAtomically.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return call(run, SetParametersAtomically, "set_parameters_atomically", request).result


def _set_and_check(name: str, value: float | list[str], wanted: bool) -> Callable[[LiveRun], None]:
    def act(run: LiveRun) -> None:
        result = set_parameter(run, name, value)
        if result.successful != wanted:
            raise LiveFailure(f"{name} = {value}: {result.reason or 'accepted, but must be rejected'}")

    return act


def _call_service(name: str) -> Callable[[LiveRun], None]:
    def act(run: LiveRun) -> None:
        answer = call(run, Trigger, name, Trigger.Request())
        if not answer.success:
            raise LiveFailure(f"~/{name}: {answer.message}")

    return act


_ACTIONS: tuple[Action, ...] = (
    (0.20, _set_and_check("gate.probability", 0.99, wanted=True)),
    (0.25, _set_and_check("sources_off", ["star.fore"], wanted=True)),
    (0.30, _set_and_check("gate.probability", 0.1, wanted=False)),
    (0.40, _set_and_check("ins.white_sigma_arcsec", 2.0, wanted=True)),
    (0.45, _set_and_check("sources_off", [], wanted=True)),
    (0.50, _call_service("save_alignment")),
    (0.60, _call_service("reset")),
    (0.80, _call_service("load_alignment")),
)


class _Plan:
    """Actions at their times in a run."""

    def __init__(self, run: LiveRun, length_s: float, actions: Iterable[Action]) -> None:
        self._run = run
        self._due = [(part * length_s, act) for part, act in actions]

    def run_due(self, elapsed_s: float) -> None:
        """Run the actions that are due."""
        while self._due and elapsed_s >= self._due[0][0]:
            self._due.pop(0)[1](self._run)

    def finish(self) -> None:
        """Raise an error if an action was not run."""
        if self._due:
            raise LiveFailure(f"{len(self._due)} actions had not been run at the end of the voyage")


def _voyage(folder: Path, duration_s: float) -> Path:
    """Simulate the voyage; return its bag."""
    scenario = yaml.safe_load(SCENARIO.read_text(encoding="utf-8"))
    scenario["duration_s"] = duration_s
    scenario_path, bag_path = folder / "scenario.yaml", folder / "voyage.mcap"
    scenario_path.write_text(yaml.safe_dump(scenario), encoding="utf-8")
    if simulate([str(scenario_path), "--out", str(bag_path), "--seed", "1", "--force"]) != EXIT_DONE:
        raise LiveFailure("the voyage could not be simulated")
    return bag_path


def _box_path(log: str) -> Path:
    """Return the path of the black box from the node's log."""
    lines = [line for line in log.splitlines() if "black box: " in line]
    if not lines:
        raise LiveFailure(f"no black box in the log of the node:\n{log}")
    return Path(lines[0].partition("black box: ")[2])


if __name__ == "__main__":
    sys.exit(main())
