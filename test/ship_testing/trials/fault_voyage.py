"""One voyage with faults: faults are drawn, injected, replayed through the nodes in this process, and evaluated."""

import dataclasses
import math
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.mcap.bag_reader import Bag, read_bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_replay.evaluation.sources import Truth
from ship_replay.offline.adapter_chain import suite_chain
from ship_replay.offline.replay import ADAPTERS
from ship_replay.offline.replay_run import ReplayRun
from ship_replay.offline.replay_summary import ReplaySummary
from ship_simulation.inject_command import Injection
from ship_simulation.random_draws import random_stream
from ship_simulation.scenario.names import IMAGE_TOPIC
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.simulate_command import write_bag
from ship_testing.trials.fault_evaluation import evaluate_fault, exceedance_durations
from ship_testing.trials.fault_free_replay import FaultFreeReplay
from ship_testing.trials.threats import OVERLAPPING, SINGLE, DrawnFault, draw_faults
from ship_testing.trials.voyage_outputs import VoyageOutputs, VoyageSink
from ship_watch.orientations import ORIENTATIONS
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter


@dataclass(frozen=True)
class Voyage:
    """A voyage to be run.

    Attributes:
        number: number of the voyage, and seed of its faults.
        bag: bag without faults.
        mode: SINGLE or OVERLAPPING.
    """

    number: int
    bag: Path
    mode: str

    @property
    def key(self) -> tuple[int, str, str]:
        """Key of the voyage among results."""
        return self.number, self.bag.stem, self.mode


def voyages(bags: Sequence[Path], count: int, modes: Sequence[str] = (SINGLE, OVERLAPPING)) -> list[Voyage]:
    """Return voyages that use the bags in turn, and with each bag the modes in turn."""
    return [
        Voyage(number, bags[number % len(bags)], modes[number // len(bags) % len(modes)]) for number in range(count)
    ]


def make_bag(scenario_path: Path, duration_s: float, seed: int, path: Path) -> Path:
    """Create the bag of a scenario, cut to a maximum length, unless the file exists."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        scenario = load_scenario(scenario_path)
        scenario = dataclasses.replace(scenario, duration_s=min(duration_s, scenario.duration_s))
        write_bag(scenario, seed, path, scenario_path.read_bytes())
    return path


def run_voyage(voyage: Voyage, fault_free: FaultFreeReplay) -> dict[str, Any]:
    """Run a voyage; return its result and the outcome of each fault as plain data.

    Args:
        voyage: the voyage.
        fault_free: replay of the same voyage without faults.
    """
    start_s = time.monotonic()
    with read_bag(voyage.bag) as bag:
        length_s = (bag.end_ns - bag.start_ns) / NS_PER_S
        topics = input_topics(bag)
        rng = random_stream(voyage.number, f"voyage.{voyage.mode}")
        drawn = draw_faults(topics, length_s, voyage.mode, IntegrityConfig().return_after_s, rng)
    result: dict[str, Any] = {
        "voyage": voyage.number,
        "bag": voyage.bag.stem,
        "mode": voyage.mode,
        "exception": "",
        "failures": 0,
        "faults": [],
    }
    try:
        outcomes, outputs = replay_with_faults(voyage.bag, drawn, voyage.number, fault_free)
        result |= {
            "failures": outputs.failure_count,
            "faults": outcomes,
            "longest_beyond_s": round(exceedance_durations(outputs.valid_outputs)[1], 4),
        }
    except Exception:
        # Software defects are recorded, and the other voyages continue.
        result |= {"exception": traceback.format_exc(limit=-4), "faults": [_fault_as_dict(one) for one in drawn]}
    result["elapsed_s"] = round(time.monotonic() - start_s, 2)
    return result


def input_topics(bag: Bag) -> dict[str, str]:
    """Return topic → type of the inputs that the nodes use from a bag."""
    chain, _ = suite_chain(bag, ADAPTERS, RosbagsFactory())
    return {topic.topic: topic.type_name for topic in chain.inputs if topic.topic in bag.topics}


def replay_with_faults(
    path: Path, drawn: Sequence[DrawnFault], seed: int, fault_free: FaultFreeReplay
) -> tuple[list[dict[str, Any]], VoyageOutputs]:
    """Replay a bag with faults; return the outcome of each fault that affected a message, and the outputs."""
    faults = {f"f{number}": one.fault for number, one in enumerate(drawn)}
    injection = Injection(path, faults, seed)
    outputs = replay_injection(injection)
    outcomes = []
    for number, (name, one) in enumerate(zip(faults, drawn, strict=True)):
        changed_ns = np.array(injection.effect(name).times_ns)
        if not changed_ns.size:
            continue
        later = [other.fault.start_s for other in drawn[number + 1 :]]
        outcome = evaluate_fault(one.fault, changed_ns, outputs, fault_free, min([*later, fault_free.length_s]))
        plain = {key: _json_value(value) for key, value in dataclasses.asdict(outcome).items()}
        row = {"threat": fault_free.undetectable_case(one.fault, int(changed_ns[0])) or one.threat.label}
        outcomes.append(_fault_as_dict(one) | row | plain | {"alert_limit_s": fault_free.alert_limit_s(one.fault)})
    return outcomes, outputs


def replay_fault_free(path: Path) -> FaultFreeReplay:
    """Replay a voyage without faults."""
    arrivals: dict[str, list[int]] = {}
    beacon_times_ns: list[int] = []
    with read_bag(path) as bag:
        chain, _ = suite_chain(bag, ADAPTERS, RosbagsFactory())
        for record in bag.records({topic.topic for topic in chain.inputs if topic.topic in bag.topics}):
            arrivals.setdefault(record.topic, []).append(record.log_time_ns)
            if record.topic == IMAGE_TOPIC and record.decode().beacons:
                beacon_times_ns.append(record.log_time_ns)
        ship = chain.configs.get(ShipAttitudeAdapter.node_name)
        pointing = chain.configs.get(OpticalAxisAdapter.node_name)
        return FaultFreeReplay(
            outputs=replay_injection(Injection(path, {}, 0)),
            arrivals_ns={topic: np.array(times) for topic, times in arrivals.items()},
            beacon_times_ns=np.array(beacon_times_ns),
            encoder_sigma_arcsec=math.nan if pointing is None else pointing.encoder.sigma_arcsec,
            ins_sigma_arcsec=math.nan if ship is None else ship.ins.white_sigma_arcsec,
            start_ns=bag.start_ns,
            end_ns=bag.end_ns,
        )


def replay_injection(injection: Injection) -> VoyageOutputs:
    """Replay a bag with faults through the nodes in this process; return the outputs."""
    with read_bag(injection.path) as bag:
        chain, _ = suite_chain(bag, ADAPTERS, RosbagsFactory())
        input_topic_names = {topic.topic for topic in chain.inputs}
        sink = VoyageSink(_truths(bag))
        run = ReplayRun(chain, sink, ReplaySummary(), truth_topics=())
        for record in injection.records(bag):
            if record.topic in input_topic_names:
                run.process_message(record.topic, record)
        run.finish()
    return sink.outputs


@lru_cache(maxsize=8)
def _truths_of(path: Path) -> dict[str, Truth]:
    truths: dict[str, Truth] = {}
    with read_bag(path) as bag:
        for orientation in ORIENTATIONS:
            truth = Truth(orientation)
            for record in bag.records({orientation.truth_topic}):
                truth.add(record.decode())
            truths[orientation.topic] = truth
    return truths


def _truths(bag: Bag) -> dict[str, Truth]:
    """Return the truth of a bag, which faults do not change."""
    return _truths_of(bag.path)


def _fault_as_dict(one: DrawnFault) -> dict[str, Any]:
    """Return a fault as plain data, without unused sizes."""
    given = {name: getattr(one.fault, name) for name in one.fault.sizes}
    if one.fault.share < 1.0:
        given["share"] = one.fault.share
    return {
        "threat": one.threat.label,
        "topic": one.fault.topic,
        "kind": one.fault.kind,
        "start_s": one.fault.start_s,
        "end_s": one.fault.end_s,
        "sizes": {name: value for name, value in given.items() if name == "value" or value not in (0, 0.0, "")},
        "sigmas": one.threat.sigmas(given),
    }


def _json_value(value: Any) -> Any:
    """Return a value for JSON, rounded to four decimals: None for NaN, 1e300 for infinity of either sign."""
    if isinstance(value, float):
        return round(value, 4) if math.isfinite(value) else None if math.isnan(value) else 1e300
    return value
