"""The comparisons of star measurements with the INS in a bag, as the filter of ``ship_attitude`` makes them.

The bag goes through the suite's own node, so that axes, clocks, skies and refusals are those of a voyage. The node
judges what is improbable by wider sigmas than configured, for it is those sigmas that are in question; of what it uses
the comparison itself is kept, linearised at its estimate and told relative to no error at all.
"""

import functools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ship_attitude_star.ins_errors.config import GAUSS_MARKOV
from ship_attitude_star.measurements.samples import AttitudeDecision
from ship_attitude_star.ros.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ros.star_attitude_adapter import StarAttitudeAdapter
from ship_attitude_star.ship_attitude.config import InsConfig, ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import INS, ShipAttitudeCore
from ship_attitude_star.ship_attitude.model import ShipStateModel
from ship_attitude_star.vertical.config import UNKNOWN, GravityConfig
from ship_attitude_star.vertical.vertical_track import VerticalHere
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.message_factory import MessageFactory
from ship_bags.message_store import RosbagsFactory
from ship_geometry.rotations import FloatArray
from ship_node.documents.saved_document import DISK, Files
from ship_node.edge.reporting_adapter import Feed
from ship_node.edge.topics import Published
from ship_replay.offline.adapter_chain import suite_chain
from ship_replay.offline.replay import Watcher, match_inputs
from ship_replay.offline.replay_run import ReplayRun, ReplaySummary

_WIDER = 3.0
"""A sigma that is wrong by this factor must not lead to refusals: what is refused cannot say so."""


class StarPair(NamedTuple):
    """A star measurement against the INS: value = jacobian @ (errors of the filter's model) + noise.

    Attributes:
        time_ns: stamp of the measurement.
        source: ``star.<id>``.
        value: measured minus what no error would give, rad, shape (m,).
        jacobian: per state of the model, shape (m, n).
        noise: covariance of the noise that the measurement states, rad², shape (m, m).
        here: latitude and velocity of the ship, and the vertical where it is given.
    """

    time_ns: int
    source: str
    value: FloatArray
    jacobian: FloatArray
    noise: FloatArray
    here: VerticalHere


@dataclass
class PairsHeard:
    """The pairs of a session.

    Attributes:
        found: by source and stamp.
        refused: measurements that the node did not use.
    """

    found: dict[tuple[str, int], StarPair] = field(default_factory=dict)
    refused: set[tuple[str, int]] = field(default_factory=set)

    def take(self, core: ShipAttitudeCore, decisions: Iterable[AttitudeDecision]) -> None:
        """Keep what was used; a decision that was revised takes the place of the earlier one."""
        for decision in decisions:
            self._take(core, decision)

    def _take(self, core: ShipAttitudeCore, decision: AttitudeDecision) -> None:
        measurement = decision.measurement
        key = measurement.source, measurement.time_ns
        self.found.pop(key, None)
        self.refused.discard(key)
        linearised = core.linearised(measurement) if decision.accepted else None
        if linearised is None:
            self.refused.add(key)
            return
        assert core.vertical is not None
        linear, here = linearised.compared.linear, core.vertical.at(measurement.time_ns)
        value = linear.residual + linear.jacobian @ core.state.mean
        if here.given is not None:
            # The INS levels itself on gravity: what is known of that is no error of it.
            attitude = core.filter.model.slices["ins.attitude"]
            value = value - linear.jacobian[:, attitude] @ (here.turn @ here.given)
        self.found[key] = StarPair(measurement.time_ns, measurement.source, value, linear.jacobian, linear.noise, here)


@dataclass(frozen=True)
class NoiseSession:
    """What a bag has to say of its INS.

    Attributes:
        name: of the bag.
        config: of the node, as configured.
        model: states of the pairs.
        pairs: in the order of their stamps.
        common_n: by source, the steady covariance of what its messages share, rad², shape (3, 3).
        refused: star measurements that were not used.
        problems: what is wrong with the bag, one line each.
    """

    name: str
    config: ShipAttitudeConfig
    model: ShipStateModel
    pairs: list[StarPair]
    common_n: Mapping[str, FloatArray]
    refused: int
    problems: list[str]


def session_of(
    name: str, config: ShipAttitudeConfig, core: ShipAttitudeCore, heard: PairsHeard, problems: list[str]
) -> NoiseSession:
    """What a core that was given a whole bag has heard."""
    pairs = sorted(heard.found.values(), key=lambda pair: (pair.time_ns, pair.source))
    return NoiseSession(name, config, core.filter.model, pairs, dict(core.state.common_n), len(heard.refused), problems)


def run_session(
    bag_path: Path,
    config_path: Path | None = None,
    namespace: str = "",
    watch: Watcher = lambda records, bag: records,
) -> NoiseSession:
    """Run a bag through the suite.

    Args:
        bag_path: .mcap file or rosbag2 folder.
        config_path: suite configuration; None takes the one attached to the bag.
        namespace: namespace of the ship in the bag.
        watch: wraps the iteration over the bag, for a progress bar.

    Raises:
        BadInput: the bag or the configuration does not serve, or no star measurement was used.
    """
    heard, listening = PairsHeard(), []

    class Listening(ShipAttitudeAdapter):
        def __init__(self, config: ShipAttitudeConfig, factory: MessageFactory, files: Files = DISK) -> None:
            super().__init__(session_config(config), factory, files)
            self.configured = config
            listening.append(self)

        def table(self, config: ShipAttitudeConfig, core: ShipAttitudeCore) -> Iterator[Feed]:
            for feed in super().table(config, core):
                if feed.source == INS:
                    # No attitude is asked for, which would take as long as all the rest.
                    feed = replace(feed, take=functools.partial(core.add_ins, estimate=False), block=None)
                yield feed

        def published(self, outcome: Any, now_ns: int, waiting_ns: int) -> list[Published]:
            heard.take(self.core, outcome.decisions)
            return []

    with read_bag(bag_path) as bag:
        chain, left_out = suite_chain(bag, (Listening, StarAttitudeAdapter), RosbagsFactory(), config_path, namespace)
        if not listening or not listening[0].config.star_sensors:
            text = f"the configuration has no star_sensors of {ShipAttitudeAdapter.node_name}: nothing tells what the"
            raise BadInput(f"{text} INS does", file=bag.path)
        adapter = listening[0]
        names = {name: relative for relative, name in match_inputs(bag, chain, namespace).items()}
        summary = ReplaySummary()
        run = ReplayRun(chain, _Nowhere(), summary, ())
        for record in watch(bag.records(names), bag):
            run.take(names[record.topic], record)
        unread = [f"topic '{topic}': {count} messages cannot be read" for topic, count in summary.undecodable.items()]
        problems = [*left_out, *bag.problems, *unread]
        if not heard.found:
            counts = f"{len(heard.refused)} came and were refused" if heard.refused else "none came"
            raise BadInput(f"no star measurement was used ({counts}): nothing tells what the INS does", file=bag.path)
        return session_of(bag_path.name, adapter.configured, adapter.core, heard, problems)


def session_config(config: ShipAttitudeConfig) -> ShipAttitudeConfig:
    """The configuration of a session: what it is not about is left out, and the INS may do what it likes.

    A saved alignment may rest on this very bag. The vertical is asked for where the ship is, whether its deflection
    matters or not.
    """
    gravity = config.gravity if config.gravity.is_modelled else GravityConfig(deflection=UNKNOWN)
    return replace(config, ins=_wider(config.ins), gravity=gravity, references={}, alignment_file="", sources_off=())


def _wider(ins: InsConfig) -> InsConfig:
    return replace(
        ins,
        model=GAUSS_MARKOV,
        tilt_sigma_arcsec=_WIDER * ins.tilt_sigma_arcsec,
        heading_sigma_arcsec=_WIDER * ins.heading_sigma_arcsec,
        white_sigma_arcsec=_WIDER * ins.white_sigma_arcsec,
    )


class _Nowhere:
    """Takes what the other nodes publish and keeps nothing."""

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Pass over a message."""

    def write_raw(self, topic: str, type_name: str, data: bytes, log_time_ns: int) -> None:
        """Pass over the truth: an identification must not see it."""


def place_of(pairs: Iterable[StarPair]) -> VerticalHere | None:
    """Mean latitude and velocity of the ship over the pairs; None where no position fix told them."""
    places = [pair.here for pair in pairs if not np.isnan(pair.here.latitude)]
    if not places:
        return None
    north, east = np.mean([here.velocity_m_per_s for here in places], axis=0).tolist()
    latitude = float(np.mean([here.latitude for here in places]))
    return VerticalHere(0.0, latitude, (north, east), None, np.zeros((2, 2)))
