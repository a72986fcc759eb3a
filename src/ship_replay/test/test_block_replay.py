"""A replay in batches publishes the same messages at the same times as one by one, byte for byte.

The scenarios are those of the repository, shortened; the faults are drawn by seed from those of the injector.
FAULTED_BAGS is the number of bags of the demo with drawn faults; half as many bags of all nodes have drawn faults.
"""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.ins_input import InsInput
from ship_attitude_star.star_attitude.core import StarCore
from ship_bags.mcap.bag_reader import BagRecord, read_bag
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import NS_PER_S
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_replay.offline.adapter_chain import suite_chain
from ship_replay.offline.replay import ADAPTERS
from ship_replay.offline.replay_run import LARGEST_BATCH, ReplayRun
from ship_replay.offline.replay_summary import ReplaySummary
from ship_simulation.inject_command import Injection
from ship_simulation.random_draws import random_stream
from ship_testing.memory_sink import MemorySink, Published
from ship_testing.overconfident_filter import make_overconfident
from ship_testing.trials.fault_voyage import input_topics, make_bag
from ship_testing.trials.threats import OVERLAPPING, SINGLE, draw_faults
from theodolite_calib.optical_axis.pointings import Pointings

SCENARIOS = Path(__file__).resolve().parents[3] / "bags" / "scenarios"
NAMES = [
    "deflection", "demo", "everything", "late_shuffled", "outage", "paper_stars", "sea_state_5", "theodolite",
    "three_sensors",
]  # fmt: skip
FAULTED_BAGS = int(os.environ.get("FAULTED_BAGS", "6"))
FAULT_SECONDS, SUITE_SECONDS = 45.0, 30.0
BATCH_SIZES = 7, 100, 1_000_000_000
"""Sizes of batches that are compared with messages one by one; the last one contains the whole bag."""


def replay_faults(bag_path: Path, injection: Injection, batch_size: int) -> tuple[Published, ReplaySummary]:
    with read_bag(bag_path) as bag:
        chain, _ = suite_chain(bag, ADAPTERS, RosbagsFactory())
        truth = {topic for topic in bag.topics if topic.startswith("truth/")}
        taken, sink, summary = {topic.topic for topic in chain.inputs} | truth, MemorySink(), ReplaySummary()
        run = ReplayRun(chain, sink, summary, truth, batch_size)
        records: Iterator[BagRecord] = injection.records(bag)
        for record in records:
            if record.topic in taken:
                run.process_message(record.topic, record)
        run.finish()
        summary.rejected = {a.node_name: a.health.rejection_and_note_counts() for a in chain.adapters}
    return sink.published, summary


def assert_equal(bag_path: Path, injection: Injection | None = None) -> None:
    injection = injection or Injection(bag_path, {}, 0)
    expected = replay_faults(bag_path, injection, 1)
    for batch_size in BATCH_SIZES:
        assert_same(*expected, *replay_faults(bag_path, injection, batch_size))


def assert_same(expected: Published, of_run: ReplaySummary, found: Published, of_batches: ReplaySummary) -> None:
    assert {topic: len(messages) for topic, messages in found.items()} == {
        topic: len(messages) for topic, messages in expected.items()
    }
    for topic, messages in expected.items():
        odd = next((n for n, (one, other) in enumerate(zip(messages, found[topic], strict=True)) if one != other), None)
        assert odd is None, f"{topic}: message {odd} of {len(messages)} at {messages[odd][0]}"
    counts = [(summary.inputs, summary.outputs, summary.rejected) for summary in (of_run, of_batches)]
    assert counts[0] == counts[1]
    for topic, history in of_run.status_histories.items():
        assert (of_batches.status_histories[topic].counts, of_batches.status_histories[topic].spans) == (
            history.counts,
            history.spans,
        )
    exclusions = [{topic: one.lines(0) for topic, one in each.exclusions.items()} for each in (of_run, of_batches)]
    assert exclusions[0] == exclusions[1]
    for topic, times in of_run.times.items():
        for one, other in zip(_gaps(times), _gaps(of_batches.times[topic]), strict=True):
            np.testing.assert_array_equal(one, other)
    assert of_batches.log_delays.irregularity_text() == of_run.log_delays.irregularity_text()
    assert of_batches.log_delays.median_ns() == of_run.log_delays.median_ns()


def _gaps(times: Any) -> list[np.ndarray]:
    return [*times.stamps.seconds(), *times.arrivals.seconds()]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_scenarios(tmp_path: Path, name: str) -> None:
    assert_equal(make_bag(SCENARIOS / f"{name}.yaml", 25.0, 1, tmp_path / f"{name}.mcap"))


@pytest.mark.slow
@pytest.mark.parametrize("latency_s", [2.15, 2.25])
def test_an_ins_that_comes_about_lag_s_after_the_stars(tmp_path: Path, latency_s: float) -> None:
    """If the newest star attitude is more than ``lag_s`` ahead, even an INS sample in order is late."""
    text = (SCENARIOS / "demo.yaml").read_text()
    assert text.count("ins:\n  rate_hz") == 1
    scenario = tmp_path / "late_ins.yaml"
    scenario.write_text(text.replace("ins:\n", f"ins:\n  latency_s: {latency_s}\n"))
    assert_equal(make_bag(scenario, 25.0, 1, tmp_path / "late_ins.mcap"))


@pytest.fixture(scope="session")
def clean_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_bag(SCENARIOS / "demo.yaml", FAULT_SECONDS, 2, tmp_path_factory.mktemp("faulted") / "demo.mcap")


@pytest.fixture(scope="session")
def suite_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag for all nodes: star_attitude solves stars, and the theodolite uses ship/attitude."""
    path = tmp_path_factory.mktemp("faulted") / "everything.mcap"
    return make_bag(SCENARIOS / "everything.yaml", SUITE_SECONDS, 2, path)


def draw_injection(bag_path: Path, seed: int) -> Injection:
    mode = (SINGLE, OVERLAPPING)[seed % 2]
    with read_bag(bag_path) as bag:
        rng = random_stream(seed, f"voyage.{mode}")
        length_s = (bag.end_ns - bag.start_ns) / NS_PER_S
        drawn = draw_faults(input_topics(bag), length_s, mode, IntegrityConfig().return_after_s, rng)
    return Injection(bag_path, {f"f{number}": one.fault for number, one in enumerate(drawn)}, seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(FAULTED_BAGS))
def test_faulted_bags(clean_bag: Path, seed: int) -> None:
    assert_equal(clean_bag, draw_injection(clean_bag, seed))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(FAULTED_BAGS // 2))
def test_faulted_bags_of_all_nodes(suite_bag: Path, seed: int) -> None:
    assert_equal(suite_bag, draw_injection(suite_bag, seed))


@pytest.mark.slow
def test_a_second_estimator_that_is_adopted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The filter is corrupted after 20 s; half a minute later the second estimator replaces it."""
    bag, adopted, faulty = make_bag(SCENARIOS / "demo.yaml", 70.0, 3, tmp_path / "demo.mcap"), [], set()
    with read_bag(bag) as content:
        start_ns = content.start_ns
    look = ShipAttitudeAdapter._decide

    def decide_with_fault(self: ShipAttitudeAdapter, now_ns: int, waiting_ns: int) -> Any:
        self.recovery._config = replace(self.recovery._config, confirm_s=30.0)
        if waiting_ns - start_ns >= 20 * NS_PER_S and id(self) not in faulty:
            faulty.add(id(self))
            make_overconfident(self)
        published = look(self, now_ns, waiting_ns)
        if self.recovery.adopted > adopted.count(id(self)):
            adopted.append(id(self))
        return published

    monkeypatch.setattr(ShipAttitudeAdapter, "_decide", decide_with_fault)
    assert_equal(bag)
    assert len(adopted) == len(set(adopted)) == 1 + len(BATCH_SIZES)


@pytest.mark.slow
@pytest.mark.parametrize("core", [InsInput, StarCore])
def test_most_of_a_healthy_ins_is_taken_in_blocks(
    suite_bag: Path, core: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blocks contain over 80 % of the INS samples; otherwise one-by-one replay would be compared with itself."""
    taken = []
    finish_block = core.finish_block

    def count_accepted(self: Any, batch: Any) -> Any:
        taken.append(batch.checked.accepted_count)
        return finish_block(self, batch)

    monkeypatch.setattr(core, "finish_block", count_accepted)
    _, summary = replay_faults(suite_bag, Injection(suite_bag, {}, 0), LARGEST_BATCH)
    assert sum(taken) > 0.8 * summary.inputs["ins/imu"]


@pytest.mark.slow
def test_nearly_all_pointings_are_put_out_together(suite_bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counts = []
    compute_pending = Pointings.compute_pending

    def count_pending(self: Pointings) -> Any:
        counts.append(len(self.pending or []))
        return compute_pending(self)

    monkeypatch.setattr(Pointings, "compute_pending", count_pending)
    _, summary = replay_faults(suite_bag, Injection(suite_bag, {}, 0), LARGEST_BATCH)
    assert sum(counts) > 0.8 * summary.inputs["theodolite/encoder"]
    assert max(counts) > 10
