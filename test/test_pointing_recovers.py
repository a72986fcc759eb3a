"""While the pointing is in trouble, a second estimator processes the same inputs; if consistent, it replaces the first.

The bag is that of the return matrix: two lights all the time, at low rates.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_estimation.time_order.outcome import Status
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC
from ship_node.saved_files.saved_document import READ_ONLY
from ship_replay.evaluation.sources import Truth
from ship_replay.offline.adapter_chain import AdapterChain, suite_config
from ship_replay.offline.replay_run import LARGEST_BATCH, ReplayRun
from ship_replay.offline.replay_summary import ReplaySummary
from ship_simulation.inject_command import Injection
from ship_simulation.scenario.fault import Fault
from ship_stars.sky.sky_model import SkyModel
from ship_testing.memory_sink import MemorySink
from ship_testing.returns.voyages import make_bag
from ship_testing.theodolite_scenes import replace_nested
from ship_testing.trials.voyage_outputs import VoyageSink
from ship_watch.orientations import ORIENTATIONS
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.messages.output_messages import POINTING_TOPIC
from theodolite_calib.smoothing import SmoothingAxisCore

pytestmark = pytest.mark.slow

SESSION_S = 330.0
FAULT_S, LASTS_S = 40.0, 30.0
END_S = FAULT_S + LASTS_S
NEVER_S = 1e6
RETURNS_S = 180.0
"""Time within which the pointing must be VALID once all inputs are consistent."""


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_bag("theodolite", tmp_path_factory.mktemp("recovers"))


class _Sink(VoyageSink):
    """Sink that also stores the statuses of the pointing and the texts of the diagnostics of recovery."""

    def __init__(self, truths: dict[str, Truth]) -> None:
        super().__init__(truths)
        self.topics |= {DIAGNOSTICS_TOPIC}
        self.statuses: list[tuple[int, int]] = []
        self.stamps: list[tuple[int, int]] = []
        self.texts: set[str] = set()

    def write(self, topic: str, message: object, log_time_ns: int) -> None:
        super().write(topic, message, log_time_ns)
        if topic == POINTING_TOPIC:
            self.statuses.append((log_time_ns, int(message.status)))
            self.stamps.append((ns_from_stamp(message.header.stamp), int(message.status)))
        elif topic == DIAGNOSTICS_TOPIC:
            self.texts |= {status.message for status in message.status if status.name.endswith("recovery")}


@dataclass(frozen=True)
class ReplayResult:
    """Results of a replay.

    Attributes:
        adapter: adapter of the node.
        recovery_s: time after which the pointing was VALID, except for single rejected exposures.
        worst_over_level: largest error while VALID, over its protection level.
        texts: texts of the diagnostics of recovery.
    """

    adapter: OpticalAxisAdapter
    recovery_s: float
    worst_over_level: float
    texts: set[str]


def replay_with_faults(
    batch_size: int,
    path: Path,
    faults: Sequence[Fault],
    sink: object,
    node: type[OpticalAxisAdapter] = OpticalAxisAdapter,
    **changes: object,
) -> OpticalAxisAdapter:
    """Return the node after a replay with faults, with dotted parameters changed (``__`` for the dot)."""
    with read_bag(path) as bag:
        config = suite_config(bag, OpticalAxisAdapter, None, "/optical_axis")
    adapter = node(replace_nested(config, **changes), RosbagsFactory(), READ_ONLY)
    chain = AdapterChain([adapter])
    run = ReplayRun(chain, sink, ReplaySummary(), set(), batch_size)
    taken = {topic.topic for topic in chain.inputs}
    with read_bag(path) as bag:
        for record in Injection(path, {f"f{number}": one for number, one in enumerate(faults)}, 1).records(bag):
            if record.log_time_ns > bag.start_ns + SESSION_S * NS_PER_S:
                break
            if record.topic in taken:
                run.process_message(record.topic, record)
    run.finish()
    return adapter


def read_result(path: Path, *faults: Fault, **changes: object) -> ReplayResult:
    truths = {}
    with read_bag(path) as bag:
        start_ns = bag.start_ns
        for orientation in ORIENTATIONS:
            truths[orientation.topic] = Truth(orientation)
            for record in bag.records({orientation.truth_topic}):
                truths[orientation.topic].add(record.decode())
    sink = _Sink(truths)
    adapter = replay_with_faults(1, path, faults, sink, **changes)
    times_s, statuses = (np.array(column) for column in zip(*sink.statuses, strict=True))
    times_s = (times_s - start_ns) / NS_PER_S
    begins = np.flatnonzero(np.diff(statuses != 0, prepend=0))
    # A single rejected exposure makes one or a few outputs DEGRADED.
    spans = [
        (times_s[first], end_s)
        for first, end_s in zip(begins, [*times_s[begins[1:]], np.inf], strict=True)
        if statuses[first] != 0
    ]
    long = [end_s for begin_s, end_s in spans if end_s - begin_s > 1.0]
    levels = [claim.level_ratio for claim in sink.outputs.valid_outputs]
    return ReplayResult(adapter, max(long, default=0.0), float(np.nanmax(levels)), sink.texts)


CLOCKS = [
    Fault(topic=topic, kind="clock_step", start_s=FAULT_S, end_s=END_S, step_s=-0.1)
    for topic in ("theodolite/encoder", "theodolite/beacons")
]
HISTORY = [
    Fault(topic="theodolite/beacons", kind="knock", start_s=37.4, end_s=61.0, right_arcsec=-151.6),
    Fault(topic="ship/attitude", kind="bias", start_s=40.7, end_s=49.4, north_arcsec=-17.0),
    Fault(topic="beacon/a/baseline", kind="freeze", start_s=44.1, end_s=63.8),
    Fault(topic="theodolite/encoder", kind="drift", start_s=61.8, end_s=78.2, azimuth_arcsec_per_min=-59.2),
    Fault(topic="theodolite/encoder", kind="drift", start_s=125.6, end_s=144.3, azimuth_arcsec_per_min=176.9),
]
"""One of the random histories of the return matrix."""

ANTENNA = [
    Fault(topic=f"beacon/{id_}/baseline", kind="wrong_fix", start_s=FAULT_S, end_s=NEVER_S, east_m=1.0) for id_ in "ab"
]


@pytest.mark.parametrize(
    ("faults", "end_s", "within_s"), [(CLOCKS, END_S, 75.0), (HISTORY, 144.3, 130.0)], ids=["clocks", "history"]
)
def test_the_pointing_returns_where_the_first_estimator_does_not(session, faults, end_s, within_s):
    without, recovers = read_result(session, *faults, recovery__after_s=NEVER_S), read_result(session, *faults)
    assert without.recovery_s > end_s + RETURNS_S
    assert recovers.recovery_s < end_s + within_s
    assert (without.adapter.recovery.adopted, recovers.adapter.recovery.adopted) == (0, 1)
    assert recovers.worst_over_level < 1.0


def test_a_moved_antenna_of_the_ship_is_not_adopted(session):
    moved = read_result(session, *ANTENNA)
    assert moved.adapter.recovery.adopted == 0
    assert moved.recovery_s == np.inf
    assert moved.worst_over_level < 1.0
    assert any("if the ship's antenna" in text and "~/reset" in text for text in moved.texts)


def test_without_a_fault_there_is_no_second_estimator_and_the_outputs_are_those_without_recovery(session):
    with_recovery, without = MemorySink(), MemorySink()
    adapter = replay_with_faults(LARGEST_BATCH, session, [], with_recovery)
    replay_with_faults(LARGEST_BATCH, session, [], without, recovery__after_s=NEVER_S)
    assert adapter.recovery.started == 0
    assert with_recovery.published == without.published


@pytest.mark.parametrize("faults", [CLOCKS, ANTENNA], ids=["adopted", "not adopted"])
def test_blocks_publish_the_same_as_messages_one_by_one(session, faults):
    by_blocks, one_by_one = MemorySink(), MemorySink()
    adapters = [
        replay_with_faults(LARGEST_BATCH, session, faults, by_blocks),
        replay_with_faults(1, session, faults, one_by_one),
    ]
    assert [adapter.recovery.started for adapter in adapters] in ([1, 1], [2, 2])
    assert [adapter.recovery.adopted for adapter in adapters] == [int(faults is CLOCKS)] * 2
    assert by_blocks.published == one_by_one.published


def test_pointings_above_the_alert_limit_are_no_trouble(session):
    adapter = replay_with_faults(1, session, [], MemorySink(), integrity__alert_limit_arcsec=(10.0, 10.0, 10.0))
    assert adapter.latest.status is Status.DEGRADED
    assert adapter.recovery.started == 0


class _Smoothing(OpticalAxisAdapter):
    def make_core(self, config: OpticalAxisConfig, sky_model: SkyModel | None) -> SmoothingAxisCore:
        return SmoothingAxisCore(config, sky_model)


def test_smoothing_has_the_pointings_of_both_estimators(session):
    sink = _Sink({})
    adapter = replay_with_faults(1, session, CLOCKS, sink, _Smoothing)
    assert adapter.recovery.adopted == 1
    smoothed_ns = [estimate.time_ns for estimate in adapter.core.smooth_remaining()]
    assert smoothed_ns == [stamp_ns for stamp_ns, status in sink.stamps if status != Status.INVALID]
