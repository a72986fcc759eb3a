"""Calibration session: the suite's nodes process a bag and estimate the installation of the star sensors.

The filter is that of ``ship_attitude``, as in a replay. A smoother is not needed: installation angles are constants (or
random walks whose last value is wanted), so the last state of the filter contains all information.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_attitude_star.ship_attitude.alignment import current_alignment
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, ProgressWrapper, read_bag
from ship_bags.message_factory import MessageFactory
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S
from ship_estimation.rejection_rules import Reason
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.adapters.adapter import Adapter
from ship_node.saved_files.saved_document import DISK, Files
from ship_replay.offline.adapter_chain import AdapterChain, suite_chain
from ship_replay.offline.outputs import DecodingSink
from ship_replay.offline.replay import match_inputs
from ship_replay.offline.replay_run import process_records

_ALIGNMENT_TOPIC = "ship/alignment"
_IMPROBABLE = Reason.GATE.word, Reason.ATTITUDE_CONFLICT.word
"""Reasons of rejections that an installation error beyond its sigma causes; other errors may cause them too."""


@dataclass(frozen=True)
class InputCount:
    """Counts of a device's messages.

    Attributes:
        used_count: number of messages that the filter used.
        rejected_count: number of messages that the filter did not use.
        reasons: reason → count; includes messages used with a note (single stars rejected).
    """

    used_count: int
    rejected_count: int
    reasons: dict[str, int]

    @property
    def improbable(self) -> int:
        """Number of messages rejected as improbable."""
        return min(self.rejected_count, sum(self.reasons.get(reason, 0) for reason in _IMPROBABLE))


@dataclass(frozen=True)
class Session:
    """A session and its filter.

    Attributes:
        name: name of the bag.
        config: configuration with the sigmas at the beginning of the session.
        core: core with the state of the filter after the last message.
        counts: source (``star.<id>``, ``reference.<name>``) → counts of its messages.
        times_s: times of the history since the first entry, s, shape (n,).
        history: name of an installation angle → values and sigmas at ``times_s``, rad, shape (n, 2).
        duration_s: length of the bag, s.
        problems: problems of the bag, nodes that do not take part, and unreadable messages, one line each.
    """

    name: str
    config: ShipAttitudeConfig
    core: ShipAttitudeCore
    counts: dict[str, InputCount]
    times_s: FloatArray
    history: dict[str, FloatArray]
    duration_s: float
    problems: list[str]


def run_session(
    bag_path: Path,
    config_path: Path | None = None,
    prior_sigma_arcsec: float | None = None,
    namespace: str = "",
    progress: ProgressWrapper = lambda records, bag: records,
) -> Session:
    """Process a bag with the suite's nodes.

    Args:
        bag_path: .mcap file or rosbag2 folder.
        config_path: suite configuration; None for the configuration attached to the bag.
        prior_sigma_arcsec: prior sigma of every star sensor's installation about each sensor axis; None for the
            configured sigmas.
        namespace: namespace of the ship in the bag.
        progress: function that wraps the iteration over the bag in a progress bar.

    Raises:
        BadInput: the bag or the configuration cannot be used, or a star sensor has no usable message.
    """
    with read_bag(bag_path) as bag:
        nodes = (_node_of_session(prior_sigma_arcsec), StarAttitudeAdapter)
        chain, left_out = suite_chain(bag, nodes, RosbagsFactory(), config_path, namespace)
        adapter = _ship_adapter(bag, chain)
        config = adapter.core.config
        _check_installations(bag, config)
        names = match_inputs(bag, chain, namespace)
        _check_star_topics(bag, config, {*names.values(), *(topic.topic for topic in chain.outputs)})
        history = AlignmentHistory()
        summary = process_records(chain, progress(bag.records(names), bag), names, history)
        last_ns = bag.last_time_ns or 0
        last = current_alignment(adapter.core.filter, adapter.core.config, adapter.core.state)
        history.add(last_ns, last.names, last.values, last.covariance)
        counts = input_counts(adapter, last_ns)
        _check_used(bag, adapter.core, counts)
        return Session(
            name=bag_path.name,
            config=config,
            core=adapter.core,
            counts=counts,
            times_s=history.times_s,
            history=history.installation_history(),
            duration_s=(last_ns - bag.start_ns) / NS_PER_S,
            problems=[*left_out, *bag.problems, *summary.unread_lines()],
        )


def session_config(config: ShipAttitudeConfig, prior_sigma_arcsec: float | None) -> ShipAttitudeConfig:
    """Return the configuration of a session.

    A saved alignment is not loaded: it may result from the same session, whose data must not count twice.
    """
    stars = config.star_sensors
    if prior_sigma_arcsec is not None:
        names = (f"installation_sigma_{axis}_arcsec" for axis in ("forward", "up", "right"))
        sigmas: dict[str, Any] = dict.fromkeys(names, prior_sigma_arcsec)
        stars = {id_: replace(star, **sigmas) for id_, star in stars.items()}
    return replace(config, star_sensors=stars, alignment_file="")


def _node_of_session(prior_sigma_arcsec: float | None) -> type[Adapter]:
    """Return the node ``ship_attitude``, configured for a session."""

    class SessionAdapter(ShipAttitudeAdapter):
        def __init__(self, config: ShipAttitudeConfig, factory: MessageFactory, files: Files = DISK) -> None:
            super().__init__(session_config(config, prior_sigma_arcsec), factory, files)

    return SessionAdapter


def _ship_adapter(bag: Bag, chain: AdapterChain) -> ShipAttitudeAdapter:
    for adapter in chain.adapters:
        if isinstance(adapter, ShipAttitudeAdapter):
            return adapter
    raise BadInput(f"the configuration has no section {ShipAttitudeAdapter.node_name}", file=bag.path)


# -- bad input --------------------------------------------------------------------------------------------------


def _check_installations(bag: Bag, config: ShipAttitudeConfig) -> None:
    if not config.star_sensors:
        raise BadInput("the configuration has no star_sensors: there is nothing to calibrate", file=bag.path)
    for id_, star in config.star_sensors.items():
        for axis, sigma in zip(("forward", "up", "right"), star.installation_sigma_s, strict=True):
            if sigma < 1e-3 * ARCSEC:
                name = f"star_sensors.{id_}.installation_sigma_{axis}_arcsec"
                raise BadInput(
                    f"parameter '{name}' = {sigma / ARCSEC:g} keeps the installation fixed: set its prior sigma, "
                    "or use --prior-sigma",
                    parameters=(name,),
                    value=sigma / ARCSEC,
                )


def _check_star_topics(bag: Bag, config: ShipAttitudeConfig, there: set[str]) -> None:
    for id_, star in config.star_sensors.items():
        topic = f"star/{id_}/{star.input}"
        if topic not in there:
            stars = sorted(name for name in bag.topics if "star/" in name)
            raise BadInput(
                f"topic '{topic}' of star sensor '{id_}' is missing; found "
                f"{', '.join(stars) or 'no star data'}: record it, or remove the sensor from the configuration",
                file=bag.path,
            )


def _check_used(bag: Bag, core: ShipAttitudeCore, counts: Mapping[str, InputCount]) -> None:
    for source, device in core.filter.devices.items():
        count = counts[source]
        if device.is_star and source not in core.state.last_used_ns:
            hint = ": its installation error exceeds its sigma: use --prior-sigma" if count.improbable else ""
            reasons = ", ".join(f"{reason} {number}" for reason, number in count.reasons.items())
            raise BadInput(f"no message of {source} was used: {reasons or 'no message received'}{hint}", file=bag.path)


@dataclass
class AlignmentHistory(DecodingSink):
    """Sink that collects the history of the alignment from the outputs of a session's replay."""

    topics = frozenset({_ALIGNMENT_TOPIC})
    times_ns: list[int] = field(default_factory=list)
    names: tuple[str, ...] = ()
    values: list[FloatArray] = field(default_factory=list)
    sigmas: list[FloatArray] = field(default_factory=list)

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Add an alignment."""
        covariance = np.reshape(message.covariance, (len(message.names), len(message.names)))
        self.add(log_time_ns, tuple(message.names), np.array(message.values), covariance)

    def add(self, time_ns: int, names: tuple[str, ...], values: FloatArray, covariance: FloatArray) -> None:
        """Add an alignment."""
        self.names = names
        self.times_ns.append(time_ns)
        self.values.append(values)
        self.sigmas.append(np.sqrt(np.diagonal(covariance)))

    @property
    def times_s(self) -> FloatArray:
        """Times since the first alignment, s, shape (n,)."""
        times_ns = np.array(self.times_ns, dtype=np.int64)
        return (times_ns - times_ns[:1]) / NS_PER_S

    def installation_history(self) -> dict[str, FloatArray]:
        """Return name of an installation angle → values and sigmas, rad, shape (n, 2)."""
        angles = "azimuth", "elevation", "roll"
        wanted = [n for n, name in enumerate(self.names) if name.startswith("star.") and name.endswith(angles)]
        both = np.stack([np.array(self.values), np.array(self.sigmas)], axis=-1)
        return {self.names[n]: both[:, n] for n in wanted}


def input_counts(adapter: ShipAttitudeAdapter, now_ns: int) -> dict[str, InputCount]:
    """Return the message counts of each star sensor and reference."""
    config = adapter.core.config
    topics = {f"star/{id_}/{star.input}": f"star.{id_}" for id_, star in config.star_sensors.items()}
    topics |= {f"reference/{name}/imu": f"reference.{name}" for name in config.references}
    counts = {}
    for message in adapter.health.messages(RosbagsFactory(), now_ns):
        if message.topic in topics:
            reasons = dict(zip(message.reasons, map(int, message.reason_counts), strict=True))
            counts[topics[message.topic]] = InputCount(int(message.accepted), int(message.rejected), reasons)
    return counts
