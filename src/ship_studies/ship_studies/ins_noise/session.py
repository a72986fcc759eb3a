"""Comparisons of star measurements with the INS in a bag, as computed by the filter of ``ship_attitude``.

The suite's own node processes the bag, so axes, clocks, sky and rejections are those of a voyage. The node's gate uses
larger sigmas than configured, because these sigmas are to be identified. The comparison of each used measurement is
stored, linearised at the filter's estimate and relative to zero errors.
"""

import functools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.core import ShipAttitudeCore
from ship_attitude_star.ship_attitude.measurements.prediction import LinearisedMeasurement
from ship_attitude_star.ship_attitude.model import INS, ShipStateModel
from ship_attitude_star.vertical.deflection import UNKNOWN, GravityConfig
from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import ProgressWrapper, read_bag
from ship_bags.message_factory import MessageFactory
from ship_bags.message_store import RosbagsFactory
from ship_estimation.parameters.ship_devices import GAUSS_MARKOV
from ship_geometry.rotations import FloatArray
from ship_node.adapters.adapter import Feed
from ship_node.messages.inputs_outputs import OutputMessage
from ship_node.saved_files.saved_document import DISK, Files
from ship_replay.offline.adapter_chain import suite_chain
from ship_replay.offline.outputs import NullSink
from ship_replay.offline.replay import match_inputs
from ship_replay.offline.replay_run import process_records
from ship_stars.attitude_samples import AttitudeDecision

_SIGMA_FACTOR = 3.0
"""Factor on the configured sigmas, so that sigmas too small by this factor cause no rejections."""


class StarInnovation(NamedTuple):
    """A star measurement compared with the INS: value = jacobian @ (errors of the filter's model) + noise.

    Attributes:
        time_ns: stamp of the measurement.
        source: ``star.<id>``.
        value: measured minus expected for zero errors, rad, shape (m,).
        jacobian: derivatives with respect to the states of the model, shape (m, n).
        noise: covariance of the stated measurement noise, rad², shape (m, m).
        here: latitude and velocity of the ship, and the deflection of the vertical if given.
    """

    time_ns: int
    source: str
    value: FloatArray
    jacobian: FloatArray
    noise: FloatArray
    here: LocalVertical


@dataclass
class StarComparisons:
    """Comparisons of a session.

    Attributes:
        accepted: comparisons by source and stamp.
        rejected: source and stamp of each measurement that the node did not use.
    """

    accepted: dict[tuple[str, int], StarInnovation] = field(default_factory=dict)
    rejected: set[tuple[str, int]] = field(default_factory=set)

    def add_decision(self, core: ShipAttitudeCore, decision: AttitudeDecision) -> None:
        """Add a decision of a node; a revised decision replaces the earlier one."""
        measurement = decision.measurement
        key = measurement.source, measurement.time_ns
        self.accepted.pop(key, None)
        self.rejected.discard(key)
        linearised = None
        if decision.accepted:
            # The state contains the measurement already, so the noise is not increased for INS errors that this
            # measurement shares with others. The INS samples around the stamp are still stored.
            linearised = core.filter.linearisation.linearise(
                measurement, core.state.mean, core.state.covariance, {}, core.ins.track, core.sky_model
            )
        if not isinstance(linearised, LinearisedMeasurement):
            self.rejected.add(key)
            return
        assert core.vertical is not None
        linear, here = linearised.compared.linear, core.vertical.at(measurement.time_ns)
        value = linear.residual + linear.jacobian @ core.state.mean
        if here.given_deflection is not None:
            # The INS is levelled by gravity: the given deflection is not an error of the INS.
            attitude = core.filter.model.slices["ins.attitude"]
            value = value - linear.jacobian[:, attitude] @ (here.deflection_jacobian @ here.given_deflection)
        self.accepted[key] = StarInnovation(
            measurement.time_ns, measurement.source, value, linear.jacobian, linear.noise, here
        )


@dataclass(frozen=True)
class NoiseSession:
    """Comparisons of a bag, with the model to which they refer.

    Attributes:
        name: name of the bag.
        config: configuration of the node.
        model: model with the states of the comparisons.
        comparisons: comparisons in order of stamps.
        common_n: source → steady covariance of the errors that its messages share, rad², shape (3, 3).
        rejected_count: number of star measurements that were not used.
        problems: problems of the bag, nodes that do not take part, and unreadable messages, one line each.
    """

    name: str
    config: ShipAttitudeConfig
    model: ShipStateModel
    comparisons: list[StarInnovation]
    common_n: Mapping[str, FloatArray]
    rejected_count: int
    problems: list[str]


def noise_session(
    name: str, config: ShipAttitudeConfig, core: ShipAttitudeCore, comparisons: StarComparisons, problems: list[str]
) -> NoiseSession:
    """Return the session of a core that has processed a whole bag."""
    pairs = sorted(comparisons.accepted.values(), key=lambda pair: (pair.time_ns, pair.source))
    return NoiseSession(
        name, config, core.filter.model, pairs, dict(core.state.common_n), len(comparisons.rejected), problems
    )


def run_session(
    bag_path: Path,
    config_path: Path | None = None,
    namespace: str = "",
    progress: ProgressWrapper = lambda records, bag: records,
) -> NoiseSession:
    """Process a bag with the suite's nodes.

    Args:
        bag_path: .mcap file or rosbag2 folder.
        config_path: suite configuration; None for the configuration attached to the bag.
        namespace: namespace of the ship in the bag.
        progress: function that wraps the iteration over the bag in a progress bar.

    Raises:
        BadInput: the bag or the configuration cannot be used, or no star measurement was used.
    """
    comparisons, adapters = StarComparisons(), []

    class DecisionRecorder(ShipAttitudeAdapter):
        def __init__(self, config: ShipAttitudeConfig, factory: MessageFactory, files: Files = DISK) -> None:
            super().__init__(session_config(config), factory, files)
            self.configured = config
            adapters.append(self)

        def table(self, config: ShipAttitudeConfig, core: ShipAttitudeCore) -> Iterator[Feed]:
            for feed in super().table(config, core):
                if feed.source == INS:
                    # Attitudes are not requested, because their computation would double the time.
                    feed = replace(feed, process=functools.partial(core.ins.add, estimate=False), block=None)
                yield feed

        def report_outcome(self, outcome: Any, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
            for decision in outcome.decisions:
                comparisons.add_decision(self.core, decision)
            return []

    with read_bag(bag_path) as bag:
        chain, left_out = suite_chain(
            bag, (DecisionRecorder, StarAttitudeAdapter), RosbagsFactory(), config_path, namespace
        )
        if not adapters or not adapters[0].config.star_sensors:
            text = f"the configuration has no star_sensors of {ShipAttitudeAdapter.node_name}: the error of"
            raise BadInput(f"{text} the INS is not observable", file=bag.path)
        adapter = adapters[0]
        names = match_inputs(bag, chain, namespace)
        summary = process_records(chain, progress(bag.records(names), bag), names, NullSink())
        problems = [*left_out, *bag.problems, *summary.unread_lines()]
        if not comparisons.accepted:
            counts = f"{len(comparisons.rejected)} received, all rejected" if comparisons.rejected else "none received"
            raise BadInput(f"no star measurement was used ({counts}): the INS error is not observable", file=bag.path)
        return noise_session(bag_path.name, adapter.configured, adapter.core, comparisons, problems)


def session_config(config: ShipAttitudeConfig) -> ShipAttitudeConfig:
    """Return the configuration of a session: no references, all sources on, a Gauss-Markov INS with larger sigmas.

    A saved alignment is not loaded, because it may result from the same bag. The deflection of the vertical is always
    modelled, whether it is relevant or not.
    """
    gravity = config.gravity if config.gravity.is_modelled else GravityConfig(deflection=UNKNOWN)
    ins = replace(
        config.ins,
        model=GAUSS_MARKOV,
        tilt_sigma_arcsec=_SIGMA_FACTOR * config.ins.tilt_sigma_arcsec,
        heading_sigma_arcsec=_SIGMA_FACTOR * config.ins.heading_sigma_arcsec,
        white_sigma_arcsec=_SIGMA_FACTOR * config.ins.white_sigma_arcsec,
    )
    return replace(config, ins=ins, gravity=gravity, references={}, alignment_file="", sources_off=())


def mean_location(pairs: Iterable[StarInnovation]) -> LocalVertical | None:
    """Return mean latitude and velocity of the ship over the comparisons; None without any position fix."""
    places = [pair.here for pair in pairs if not np.isnan(pair.here.latitude)]
    if not places:
        return None
    north, east = np.mean([here.velocity_m_per_s for here in places], axis=0).tolist()
    latitude = float(np.mean([here.latitude for here in places]))
    return LocalVertical(0.0, latitude, (north, east), None, np.zeros((2, 2)))
