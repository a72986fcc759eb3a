"""Voyages of the return matrix: small scenarios without faults, their bags, and the messages of a bag in memory.

Rates are the lowest realistic ones, because the cells are many. Each scenario is one of ``bags/scenarios`` with other
rates, and some scenarios have additional or changed devices.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_replay.evaluation.sources import Truth
from ship_replay.offline.adapter_chain import AdapterChain, suite_chain
from ship_replay.offline.replay import ADAPTERS
from ship_simulation.faults.device_geometry import SuiteOptics
from ship_simulation.inject_command import optics_of_bag
from ship_simulation.scenario.scenario import Reference, Scenario
from ship_simulation.scenario.scenario_file import load_scenario
from ship_simulation.scenario.theodolite_scenario import Rtk, ShipBaseline
from ship_simulation.simulate_command import write_bag
from ship_watch.orientations import ORIENTATIONS

SCENARIOS = Path(__file__).parents[3] / "bags" / "scenarios"
LENGTH_S = 480.0
"""Length of each voyage: the clean beginning, the longest faults, the longest return and some seconds, s."""

BOUND_S = {"ship/attitude": 120.0, "star/joint/solution": 15.0, "theodolite/pointing": 180.0}
"""Output → time within which it must be VALID once all inputs are consistent, s."""

_SEED = 1
_INS_HZ, _STAR_HZ, _SLOW_HZ = 20.0, 2.0, 1.0
_ENCODER_HZ, _LIGHT_HZ = 10.0, 2.0


def _ship(name: str) -> Scenario:
    """Return a scenario of the ship, with slower devices; the exposures of two sensors are not simultaneous."""
    whole = load_scenario(SCENARIOS / f"{name}.yaml")
    stars = {
        id_: replace(star, rate_hz=_STAR_HZ, phase_s=0.033 + 0.25 * place)
        for place, (id_, star) in enumerate(whole.star_sensors.items())
    }
    return replace(whole, ins=replace(whole.ins, rate_hz=_INS_HZ), star_sensors=stars)


def _paper() -> Scenario:
    """Return a ship with two sensors that solve their attitudes, another attitude system and two antennas."""
    ship = _ship("paper")
    gyro = Reference(rate_hz=_SLOW_HZ, phase_s=0.4, installation_sigma_arcsec=600.0, time_offset_sigma_s=0.05)
    antennas = ShipBaseline(forward_m=20.0, up_m=1.0, right_m=-3.0, rtk=Rtk(rate_hz=_SLOW_HZ))
    return replace(ship, references={"gyro": gyro}, ship_baseline=antennas)


def _sky() -> Scenario:
    """Return a ship with two sensors that send single stars, for the filter and for ``star_attitude``."""
    ship = _ship("paper_stars")
    return replace(ship, weather=replace(ship.weather, rate_hz=_SLOW_HZ))


def _tracker() -> Scenario:
    """Return a ship with a star sensor for inertial and one for horizon attitudes; the deflection is an input."""
    ship = _ship("paper")
    stars = ship.star_sensors
    gravity = replace(ship.gravity, told="topic", rate_hz=_SLOW_HZ, xi_arcsec=5.0, eta_arcsec=-3.0)
    tracker = replace(stars["starboard"], output="inertial_attitude")
    return replace(ship, star_sensors={**stars, "starboard": tracker}, gravity=gravity)


def _theodolite() -> Scenario:
    """Return a theodolite with two lights all the time and the ship's attitude as input."""
    whole = load_scenario(SCENARIOS / "theodolite.yaml")
    return replace(whole, ins=replace(whole.ins, rate_hz=1.0), **_pointing(whole))


def _mount() -> Scenario:
    """Return a theodolite as in :func:`_theodolite`, with a star camera on its mount and a target."""
    whole = load_scenario(SCENARIOS / "theodolite_night.yaml")
    parts = _pointing(whole)
    main = replace(whole.theodolite.main_detector, rate_hz=_SLOW_HZ)
    parts["theodolite"] = replace(parts["theodolite"], main_detector=main)
    cameras = {id_: replace(camera, rate_hz=_SLOW_HZ) for id_, camera in whole.telescopes.items()}
    targets = {id_: replace(target, hidden={}) for id_, target in whole.targets.items()}
    return replace(whole, ins=replace(whole.ins, rate_hz=1.0), telescopes=cameras, targets=targets, **parts)


def _pointing(whole: Scenario) -> dict[str, Any]:
    """Return the parts of a scenario that the theodolite needs, with slower devices and permanent lights."""
    device = replace(
        whole.theodolite,
        encoder=replace(whole.theodolite.encoder, rate_hz=_ENCODER_HZ),
        telescope=replace(whole.theodolite.telescope, rate_hz=_LIGHT_HZ),
    )
    beacons = {
        id_: replace(
            beacon,
            leaves_s=1e6,
            hidden={},
            rtk=replace(beacon.rtk, rate_hz=_LIGHT_HZ),
            imu=replace(beacon.imu, rate_hz=_LIGHT_HZ),
        )
        for id_, beacon in whole.beacons.items()
    }
    fused = replace(whole.fused_attitude, rate_hz=_ENCODER_HZ)
    return {"theodolite": device, "beacons": beacons, "fused_attitude": fused}


VOYAGES: dict[str, Callable[[], Scenario]] = {
    "paper": _paper,
    "sky": _sky,
    "tracker": _tracker,
    "theodolite": _theodolite,
    "mount": _mount,
}
"""Name of a voyage → its scenario."""


def make_bag(name: str, folder: Path) -> Path:
    """Return the path of the bag of a voyage; it is created if it does not exist."""
    path = folder / f"{name}_{LENGTH_S:.0f}s.mcap"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part.mcap")
        write_bag(replace(VOYAGES[name](), duration_s=LENGTH_S), _SEED, part, b"")
        part.rename(path)
    return path


@dataclass(frozen=True)
class Message:
    """A message of a bag, decoded; it must not be changed.

    Attributes:
        topic: topic of the message.
        content: the decoded message.
        stamp_ns: its stamp.
        log_ns: time of its arrival.
        order: its place in the bag.
    """

    topic: str
    content: Any
    stamp_ns: int
    log_ns: int
    order: int


@dataclass(frozen=True)
class VoyageData:
    """A voyage in memory.

    Attributes:
        path: of its bag.
        topics: topic → type of the inputs that the nodes take.
        messages: of these topics, in order of arrival.
        start_ns: beginning of the bag.
        truths: topic of an orientation → its truth.
        optics: cameras of its devices.
    """

    path: Path
    topics: dict[str, str]
    messages: list[Message]
    start_ns: int
    truths: dict[str, Truth]
    optics: SuiteOptics

    def chain(self) -> AdapterChain:
        """Return new nodes."""
        with read_bag(self.path) as bag:
            return suite_chain(bag, ADAPTERS, RosbagsFactory())[0]

    def time_ns(self, since_s: float) -> int:
        """Return the time this many seconds after the beginning, ns."""
        return self.start_ns + round(since_s * NS_PER_S)


@functools.lru_cache(maxsize=len(VOYAGES))
def load_voyage(path: Path) -> VoyageData:
    """Read a bag into memory."""
    with read_bag(path) as bag:
        chain, _ = suite_chain(bag, ADAPTERS, RosbagsFactory())
        topics = {topic.topic: topic.type_name for topic in chain.inputs if topic.topic in bag.topics}
        messages = []
        for order, record in enumerate(bag.records(set(topics))):
            content = record.decode()
            stamp_ns = ns_from_stamp(content.header.stamp)
            messages.append(Message(record.topic, content, stamp_ns, record.log_time_ns, order))
        truths = {}
        for orientation in ORIENTATIONS:
            truths[orientation.topic] = Truth(orientation)
            for record in bag.records({orientation.truth_topic}):
                truths[orientation.topic].add(record.decode())
        return VoyageData(path, topics, messages, bag.start_ns, truths, optics_of_bag(bag, {}))
