"""Short simulated voyages with every input of the nodes, for tests of unusable messages.

``ship_attitude`` has the INS, a star sensor of each kind, another attitude system, two antennas, the fix and the
weather; ``star_attitude`` has the same voyage, with the camera as its only star sensor. ``optical_axis`` has lights,
baselines, drones and images of targets, and the ship's attitude from ``ship/attitude``. ``optical_axis by ins`` has the
attitude from ``ins/imu``, and the drones get advised positions. ``triangulation`` has directions of three theodolites
to a buoy.
"""

import functools
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_bags.parameter_yaml import in_any_namespace
from ship_estimation.parameters.schema import build
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import ENU_FROM_HORIZON, rotation_from_angles
from ship_geometry.rotations import ARCSEC, FloatArray, log_rotation
from ship_node.adapters.node_adapter import NodeAdapter
from ship_node.parameters.parameter_file import load_config
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import simulate
from ship_simulation.scenario.scenario import Reference, Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.scenario.theodolite_scenario import Rtk, ShipBaseline
from ship_simulation.suite_file import suite_yaml
from ship_testing.adapter_runs import FACTORY, SECOND_NS, AdapterRun, Arrival, Arrivals, hand_over, stamp_of
from ship_testing.theodolite_scenes import SCENARIOS, bag_scenario, replace_nested, with_stars_and_targets
from ship_testing.theodolite_stations import buoy_direction, direction_message, triangulation_values
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.adapters.triangulation_adapter import TriangulationAdapter
from theodolite_calib.triangulation.triangulation import TriangulationConfig

NODES = ("ship_attitude", "star_attitude", "optical_axis", "optical_axis by ins", "triangulation")
_SEED = 11
_START_NS, _LATENCY_NS = 1_767_225_600 * SECOND_NS, SECOND_NS // 20


@dataclass(frozen=True)
class Voyage:
    """A node and its inputs.

    Attributes:
        new_adapter: makes the node's adapter.
        arrivals: all inputs of the node in order of arrival; change only copies of the messages.
        truth: the true attitude or pointing by stamp, as a message.
    """

    new_adapter: Callable[[], NodeAdapter]
    arrivals: Arrivals
    truth: dict[int, Any]

    def run(self, arrivals: Arrivals | None = None) -> AdapterRun:
        """Give arrivals, by default the voyage's, to a new adapter; end three seconds after the voyage's last arrival.

        Only arrivals after this end make the run longer, with one more INVALID output.
        """
        taken = self.arrivals if arrivals is None else arrivals
        run = AdapterRun(self.new_adapter())
        hand_over(run, taken, until_ns=self.arrivals[-1].receive_ns + 3 * SECOND_NS)
        return run


@functools.cache
def voyage(node: str) -> Voyage:
    """Return the voyage of one of NODES."""
    return _triangulation() if node == "triangulation" else voyage_of(node, scenario(node))


def scenario(node: str, **changes: Any) -> Scenario:
    """Return the scenario of one of NODES, with other values for some of its fields."""
    return replace(_theodolite(node) if node.startswith("optical_axis") else _ship(), **changes)


def voyage_of(node: str, given: Scenario) -> Voyage:
    """Return the voyage of one of NODES in a scenario."""
    adapter_class = {
        "ship_attitude": ShipAttitudeAdapter,
        "star_attitude": StarAttitudeAdapter,
        "optical_axis": OpticalAxisAdapter,
    }[node.partition(" ")[0]]
    config = load_config(adapter_class.config_type, suite_yaml(given), in_any_namespace(adapter_class.node_name))
    if node.endswith("by ins"):
        config = replace_nested(config, escort__enabled=True, escort__period_s=1.0)

    def new_adapter() -> NodeAdapter:
        return adapter_class(config, FACTORY)

    input_topics = {feed.topic for feed in new_adapter().inputs}
    logged = list(generate_messages([simulate(given, _SEED)], FACTORY))
    arrivals = tuple(Arrival(topic, message, log_ns) for topic, message, log_ns in logged if topic in input_topics)
    kind = "truth/pointing" if node.startswith("optical_axis") else "truth/attitude"
    return Voyage(new_adapter, arrivals, {log_ns: message for topic, message, log_ns in logged if topic == kind})


def error_in_sigmas(known: Voyage, message: Any) -> float:
    """Return the largest error about East, North, Up in sigmas; 0 if INVALID or without a truth, inf if not finite."""
    true = known.truth.get(stamp_of(message))
    if true is None or message.status == Status.INVALID:
        return 0.0
    error_n = log_rotation(_rotation(true) @ _rotation(message).T)
    variances = np.diagonal(np.reshape(message.rotation_covariance, (3, 3)))
    found = np.abs(ENU_FROM_HORIZON @ error_n) / np.sqrt(variances)
    # NaN is no small error.
    return float(np.max(found)) if np.all(np.isfinite(found)) else np.inf


def _rotation(message: Any) -> FloatArray:
    if hasattr(message, "heading"):
        return rotation_from_angles(message.heading, message.pitch, message.roll)
    return rotation_from_angles(message.azimuth, message.elevation, message.image_rotation)


def worst_error_in_sigmas(
    known: Voyage, run: AdapterRun, statuses: Collection[int] = (Status.VALID, Status.COASTING)
) -> float:
    """Return the largest error in sigmas of all outputs of a run whose status is in ``statuses``."""
    published = [m for m in run.messages(run.adapter.main_topic) if m.status in statuses]
    return max((error_in_sigmas(known, message) for message in published), default=0.0)


def topics(node: str) -> tuple[str, ...]:
    """Return the topics on which the voyage of a node has arrivals, sorted."""
    return tuple(sorted({arrival.topic for arrival in voyage(node).arrivals}))


@functools.cache
def fault_free_run(node: str) -> AdapterRun:
    """Return the run of the voyage without faults."""
    return voyage(node).run()


def _ship() -> Scenario:
    scenario = load_scenario(SCENARIOS / "three_sensors.yaml")
    ins = replace_nested(scenario.ins, rate_hz=25.0)
    antennas = ShipBaseline(forward_m=12.0, right_m=1.0, rtk=Rtk(rate_hz=5.0))
    references = {"gyro": Reference(rate_hz=5.0)}
    return replace(scenario, duration_s=4.0, ins=ins, references=references, ship_baseline=antennas)


def _theodolite(node: str) -> Scenario:
    scenario = with_stars_and_targets(bag_scenario(duration_s=5.0))
    fused = replace_nested(scenario.fused_attitude, written=not node.endswith("by ins"))
    ins = replace_nested(scenario.ins, rate_hz=20.0)
    return replace(scenario, ins=ins, star_sensors={}, telescopes={}, fused_attitude=fused)


def _triangulation() -> Voyage:
    config, arrivals = build(TriangulationConfig, triangulation_values(3)), []
    for time_ns in range(_START_NS, _START_NS + 5 * SECOND_NS, SECOND_NS // 10):
        for number in range(3):
            at_ns = time_ns + 10_000_000 * number
            seen_n = buoy_direction(number, (at_ns - _START_NS) / SECOND_NS)
            message = direction_message(at_ns, seen_n, 3.0 * ARCSEC, FACTORY)
            arrivals.append(Arrival(f"t{number}/theodolite/target_direction", message, at_ns + _LATENCY_NS))
    return Voyage(lambda: TriangulationAdapter(config, FACTORY), tuple(arrivals), {})
