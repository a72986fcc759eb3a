"""``make bench``: speed, as ratios of two things measured in one run, so that they hold on any machine.

Each benchmark is a function in BENCHMARKS that returns rows; a row with a bound decides the exit code. Processor times
are in s. Exit code 0 done; 1 a bound was not met or a process failed; 2 bad usage.
"""

import argparse
import dataclasses
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation

from bench_monitor import monitor_cost
from bench_rows import Row, process_cpu_s
from ship_attitude_star.ros.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.sky.sky_watch import installed_sky
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_attitude_star.star_attitude.exposure_solver import Mounted, solve_deck, solve_exposure
from ship_attitude_star.stars.solution import SolutionStatus
from ship_bags.cdr_template import CdrReader
from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.message_factory import RosidlFactory, message_class
from ship_bags.message_store import RosbagsFactory, message_store, serialize
from ship_estimation.ins import InsInputConfig
from ship_estimation.parameters import build
from ship_node.edge.messages_in import ins_sample
from ship_replay.trials.live_run import LiveFailure, LiveRun
from ship_replay.trials.monte_carlo import core_for, feed_attitude, feed_pointing, sky_input, star_exposure
from ship_replay.trials.one_estimate import WithoutAlternatives, WithoutIntegrity
from ship_simulation.run import SKY_SOURCES, SimulatedRun, simulate
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.suite.suite import optical_axis_configuration, star_attitude_configuration
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.step import SightingStep
from theodolite_calib.optical_axis.core import OpticalAxisCore

ROOT = Path(__file__).resolve().parents[1]
BAG = ROOT / "bags" / "demo.mcap"
RATE = 6.0
PAIRS = 3
INTEGRITY_PAIRS = 7
GREATEST_BOX_RATIO = 1.10
"""A black box may cost a tenth of its node."""
MOST_SOLUTION_RATIO = 150.0 / 46.0
"""150 us where scipy's align_vectors with sensitivity takes 46 us."""

MOST_TEMPLATE_RATIO = 0.5
MOST_READ_RATIO = 0.85
"""Of bytes to the same by message objects: made, and read and checked."""

_IMU_TYPE = "sensor_msgs/msg/Imu"

MOST_INTEGRITY_RATIO = 1.6
"""Of the filter's step with the estimates without each source, and without them."""


def black_box_cost() -> list[Row]:
    """Processor time of the live node over the demo bag, with and without its black box, by turns."""
    without, with_box = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(PAIRS):
            without.append(_node_cpu_s(folder / f"without_{number}", {}))
            with_box.append(_node_cpu_s(folder / f"with_{number}", {"black_box": f"{folder}/box.mcap"}))
    # The least of several: what else the machine does only adds.
    return [
        Row("node over the demo bag, processor time", min(without), "s"),
        Row("the same with its black box", min(with_box), "s"),
        Row("ratio: black box", min(with_box) / min(without), "x", GREATEST_BOX_RATIO),
    ]


def star_solution() -> list[Row]:
    """Two sensors of eight real stars: attitude, covariance by source and residuals, full refreshes apart."""
    scenario = dataclasses.replace(load_scenario(ROOT / "bags" / "scenarios" / "paper_stars.yaml"), duration_s=1.0)
    run = simulate(scenario, seed=1)
    config = build(StarAttitudeConfig, star_attitude_configuration(scenario))
    watch = installed_sky(config.sky)
    for _, source, index in run.arrivals():
        if source in SKY_SOURCES:
            watch.surroundings.insert(sky_input(run, source, index))
    exposures = [star_exposure(run, id_, 0) for id_ in run.stars]
    time_ns = exposures[0].time_ns
    mounted = [
        Mounted(solve_exposure(exposure, (), None, watch)[0], config.star_sensors[id_].rotation_ds)
        for id_, exposure in zip(run.stars, exposures, strict=True)
    ]
    at_once = np.zeros((len(mounted), 3, len(mounted), 3))
    solved = solve_deck(time_ns, mounted, at_once, config.star_sensors, None).solution
    assert solved.status is SolutionStatus.VALID
    stars = [mounted_.placed.stars for mounted_ in mounted]
    reference = np.concatenate([star.reference_n for star in stars])
    measured = reference @ solved.rotation_nb
    deck_us = _median_us(lambda: solve_deck(time_ns, mounted, at_once, config.star_sensors, None))
    place_us = _median_us(lambda: [watch.at(time_ns).apparent(exposure.positions) for exposure in exposures])
    scipy_us = _median_us(lambda: Rotation.align_vectors(reference, measured, return_sensitivity=True))
    return [
        Row("star solution, 2 x 8 stars, covariance and residuals: median", deck_us, "us"),
        Row("their places in the sky, two exposures: median", place_us, "us"),
        Row("scipy align_vectors with sensitivity, the same stars: median", scipy_us, "us"),
        Row("ratio: solution with its errors by source / scipy's", deck_us / scipy_us, "x", MOST_SOLUTION_RATIO),
    ]


def message_cost() -> list[Row]:
    """A sensor_msgs/Imu made as bytes and read, by templates and by the message objects of rosbags and of rclpy."""
    offline, live, kind = RosbagsFactory(), RosidlFactory(), message_class(_IMU_TYPE)
    vector = dict.fromkeys("xyz", 0.25)
    unknown = (-1.0, *(0.0,) * 8)
    fields = {
        "header": {"stamp": 1_700_000_000_123_456_789, "frame_id": "ins"},
        "orientation": {**vector, "w": 0.9},
        "angular_velocity": vector,
        "linear_acceleration": vector,
        **{f"{name}_covariance": unknown for name in ("orientation", "angular_velocity", "linear_acceleration")},
    }
    data = serialize(offline.make(_IMU_TYPE, **fields))
    assert live.encoded(_IMU_TYPE, **fields).__cdr__ == data
    reader, store, config = CdrReader(_IMU_TYPE, live.definition), message_store(), InsInputConfig()

    def sample_of(message: Any) -> None:
        ins_sample(message, config, 1_800_000_000_000_000_000)

    encoded_us = _median_us(lambda: live.encoded(_IMU_TYPE, **fields))
    rosbags_us = _median_us(lambda: serialize(offline.make(_IMU_TYPE, **fields)))
    rclpy_us = _median_us(lambda: serialize_message(live.make(_IMU_TYPE, **fields)))
    read_us = _median_us(lambda: sample_of(reader.message(data)))
    read_rosbags_us = _median_us(lambda: sample_of(store.deserialize_cdr(data, _IMU_TYPE)))
    read_rclpy_us = _median_us(lambda: sample_of(deserialize_message(data, kind)))
    return [
        Row("Imu made as bytes by its template: median", encoded_us, "us"),
        Row("ratio: by its template / by rosbags", encoded_us / rosbags_us, "x", MOST_TEMPLATE_RATIO),
        Row("ratio: by its template / by rclpy", encoded_us / rclpy_us, "x", MOST_TEMPLATE_RATIO),
        Row("Imu read into a sample by its template: median", read_us, "us"),
        Row("ratio: read by its template / by rosbags", read_us / read_rosbags_us, "x"),
        Row("ratio: read by its template / by rclpy", read_us / read_rclpy_us, "x", MOST_READ_RATIO),
    ]


class _WithPairs(ShipFilter):
    """The step with the estimates without each pair of sources, too."""

    def __init__(self, config: ShipAttitudeConfig) -> None:
        pairs = dataclasses.replace(config.integrity, pairs=True, max_hypotheses=64)
        super().__init__(dataclasses.replace(config, integrity=pairs))


def integrity_cost() -> list[Row]:
    """The filters' steps, with the estimates without each source beside them and without them, by turns."""
    ship, theodolite = _run_of("three_sensors", 20.0), _run_of("theodolite", 60.0)
    of_ship = "ship's step by three star sensors"
    return [
        *_integrity_rows(of_ship, _ship_steps_us, ship, WithoutIntegrity, ShipFilter),
        *_integrity_rows(f"{of_ship}, integrity.pairs", _ship_steps_us, ship, WithoutIntegrity, _WithPairs, None),
        *_integrity_rows(
            "theodolite's step by two lights", _theodolite_steps_us, theodolite, WithoutAlternatives, SightingStep
        ),
    ]


def _integrity_rows(
    what: str,
    steps_us: Callable[[SimulatedRun, Any], list[float]],
    run: SimulatedRun,
    without: type,
    with_: type,
    most: float | None = MOST_INTEGRITY_RATIO,
) -> list[Row]:
    pairs = [(steps_us(run, without), steps_us(run, with_)) for _ in range(INTEGRITY_PAIRS)]
    # Of each step the least of several: what else the machine does only adds.
    without_us, with_us = np.median(np.min(pairs, axis=0), axis=-1)
    return [
        Row(f"{what}, one estimate: median", without_us, "us"),
        Row("the same with integrity: median", with_us, "us"),
        Row("ratio: integrity", with_us / without_us, "x", most),
    ]


def _run_of(scenario: str, duration_s: float) -> SimulatedRun:
    found = load_scenario(ROOT / "bags" / "scenarios" / f"{scenario}.yaml")
    return simulate(dataclasses.replace(found, duration_s=duration_s), seed=1)


def _ship_steps_us(run: SimulatedRun, kind: type[ShipFilter]) -> list[float]:
    """The time of each step of a filter over a run."""
    core = core_for(run.scenario)
    core.filter = kind(core.config)
    core.reset()
    core.filter.step, times_us = _timed(core.filter.step)  # type: ignore[method-assign]
    feed_attitude(core, run)
    return times_us


def _theodolite_steps_us(run: SimulatedRun, kind: type[SightingStep]) -> list[float]:
    """The time of each step over a session."""
    config = build(OpticalAxisConfig, optical_axis_configuration(run.scenario))
    core = OpticalAxisCore(config)
    core._step_to, times_us = _timed(kind(config, core.filter))
    feed_pointing(core, run)
    return times_us


def _timed(step: Callable[..., Any]) -> tuple[Any, list[float]]:
    """A step that notes how long each call of it takes, us."""
    times_us: list[float] = []

    def timed(*arguments: Any) -> Any:
        begin_ns = time.perf_counter_ns()
        result = step(*arguments)
        times_us.append((time.perf_counter_ns() - begin_ns) * 1e-3)
        return result

    return timed, times_us


def _median_us(call: Callable[[], object], calls: int = 2000) -> float:
    times_ns = []
    for _ in range(calls):
        begin_ns = time.perf_counter_ns()
        call()
        times_ns.append(time.perf_counter_ns() - begin_ns)
    return float(np.median(times_ns)) * 1e-3


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {
    "black_box": black_box_cost,
    "messages": message_cost,
    "star_solution": star_solution,
    "integrity": integrity_cost,
    "monitor": monitor_cost,
}


def main() -> int:
    """Run the benchmarks."""
    parser = CommandParser(prog="bench", description=__doc__)
    parser.add_argument("--only", choices=sorted(BENCHMARKS), help="one of them (all)")
    return run_command(parser, _bench, None)


def _bench(options: argparse.Namespace) -> int:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    met = True
    for name, benchmark in BENCHMARKS.items():
        if options.only in (None, name):
            try:
                rows = benchmark()
            except LiveFailure as failure:
                print(f"bench: {name}: {failure}", file=sys.stderr)
                return EXIT_BOUND_NOT_MET
            for row in rows:
                print(row.line, flush=True)
                met = met and row.met
    return EXIT_DONE if met else EXIT_BOUND_NOT_MET


def _node_cpu_s(folder: Path, parameters: dict[str, str]) -> float:
    """Processor time that the node spends on the demo bag, its start left out."""
    with LiveRun(BAG, ShipAttitudeAdapter, "ship_attitude_star", folder, parameters) as run:
        begin_s = process_cpu_s(run.node.pid)
        run.play(RATE)
        return process_cpu_s(run.node.pid) - begin_s


if __name__ == "__main__":
    sys.exit(main())
