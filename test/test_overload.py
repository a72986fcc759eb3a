"""The nodes of a suite on a core that is far too slow: overload has a status, and it ends.

A bag is played at twenty times its speed, and sixteen busy loops share one core with the nodes. On any machine the
nodes then have a small part of the time that they need. After that the same nodes process the bag at twice its speed.
"""

import contextlib
import os
import re
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray

from ship_bags.live.ros_process import executable
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.stamps import ns_from_stamp
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_msgs.msg import Innovation, Integrity, OpticalAxisPointing, ShipAttitude
from ship_testing.places import ROOT
from ship_testing.trials.live_process import GraphObserver, LiveProcess, free_domain_id, live_environment

pytestmark = [pytest.mark.live, pytest.mark.slow]

NODES = {
    "star_attitude": "ship_attitude_star",
    "ship_attitude": "ship_attitude_star",
    "optical_axis": "theodolite_calib",
}
LOOPS = 16
FASTEST, USUAL = "20", "2"
BEHIND = r"{node} is \d+\.\d s behind: the computer is too slow \(1 core, load \d+\)"
MOST_SIGMAS = 6.0
LIMIT_S = 60.0


class NodeObserver:
    """Messages of the nodes, as an observer receives them.

    Attributes:
        claims: topic → status of each output.
        behind: text of each rejection with the reason BEHIND, by the name of the source.
        excluded: sources that were excluded at any time.
        overload: node → level and text of its status "overload".
        rejections: source → number of rejections with a text, and the last text.
        worst_sigmas: largest error of a VALID attitude over its sigma.
    """

    def __init__(self, observer: GraphObserver, truth: dict[int, np.ndarray]) -> None:
        self.claims: dict[str, list[int]] = defaultdict(list)
        self.behind: dict[str, list[str]] = defaultdict(list)
        self.excluded: set[str] = set()
        self.overload: dict[str, tuple[int, str]] = {}
        self.rejections: dict[str, tuple[int, str]] = {}
        self.worst_sigmas = 0.0
        self._truth = truth
        node = observer.node
        node.create_subscription(ShipAttitude, "ship/attitude", self._receive_attitude, 2000)
        pointing = self.claims["theodolite/pointing"]
        node.create_subscription(
            OpticalAxisPointing, "theodolite/pointing", lambda message: pointing.append(message.status), 2000
        )
        for topic in ("ship/innovation", "theodolite/innovation", "star/innovation"):
            node.create_subscription(Innovation, topic, self._receive_innovation, 2000)
        for topic in ("ship/integrity", "theodolite/integrity"):
            node.create_subscription(Integrity, topic, lambda message: self.excluded.update(message.excluded), 2000)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._receive_statuses, 2000)

    def _receive_attitude(self, message: ShipAttitude) -> None:
        self.claims["ship/attitude"].append(message.status)
        true = self._truth.get(ns_from_stamp(message.header.stamp))
        if message.status == Status.VALID and true is not None:
            error = np.array([message.heading, message.pitch, message.roll]) - true
            error = np.remainder(error + np.pi, 2.0 * np.pi) - np.pi
            sigmas = np.abs(error) / np.sqrt(message.covariance[::4])
            self.worst_sigmas = max(self.worst_sigmas, float(sigmas.max()))

    def summary(self) -> str:
        """Return the received messages as text, for a test that times out."""
        claims = {topic: Counter(statuses) for topic, statuses in self.claims.items()}
        return f"{claims}\nexcluded: {self.excluded}\noverload: {self.overload}\nrefusals: {self.rejections}"

    def _receive_innovation(self, message: Innovation) -> None:
        if message.reason_text:
            count, _ = self.rejections.get(message.source, (0, ""))
            self.rejections[message.source] = count + 1, message.reason_text
        if message.reason == Reason.BEHIND:
            self.behind[message.source].append(message.reason_text)

    def _receive_statuses(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, _, name = status.name.partition(": ")
            if name == "overload":
                self.overload[node] = status.level[0], status.message


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return two minutes of a ship with stars of three kinds and a theodolite with `ship_attitude` as input."""
    folder = tmp_path_factory.mktemp("overload")
    text = (ROOT / "bags" / "scenarios" / "everything.yaml").read_text(encoding="utf-8")
    (folder / "scenario.yaml").write_text(re.sub(r"^duration_s: .*$", "duration_s: 120.0", text, flags=re.MULTILINE))
    command = [*executable("ship_simulation", "simulate"), folder / "scenario.yaml"]
    subprocess.run([*command, "--out", folder / "all.mcap", "--seed", "3"], check=True, capture_output=True)
    return folder / "all.mcap"


@contextlib.contextmanager
def busy_core(core: int) -> Iterator[None]:
    """Run loops that leave little time of one core to other processes."""
    loop = ["taskset", "-c", str(core), sys.executable, "-c", "while True: pass"]
    loops = [subprocess.Popen(loop) for _ in range(LOOPS)]
    try:
        yield
    finally:
        for one in loops:
            one.kill()
            one.wait()


def test_overload_has_a_status_and_ends(bag, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain = free_domain_id()
    environment, core = live_environment(domain, tmp_path), max(os.sched_getaffinity(0))
    with read_bag(bag) as recorded:
        (tmp_path / "suite.yaml").write_bytes(recorded.attachments[SUITE_ATTACHMENT])
        inputs = [topic for topic in recorded.topics if not topic.startswith("truth")]
        attitudes = [record.decode() for record in recorded.records({"truth/attitude"})]
    truth = {ns_from_stamp(m.header.stamp): np.array([m.heading, m.pitch, m.roll]) for m in attitudes}

    def play(rate: str) -> LiveProcess:
        command = [*executable("ship_bags", "play"), str(bag), "--rate", rate, "--loop", "0", "--topics", *inputs]
        return LiveProcess(command, tmp_path / f"play_{rate}.log", environment)

    def waited_s(observer: GraphObserver, happened: Callable[[], bool]) -> float:
        start_s = time.monotonic()
        assert observer.spin_until(happened, LIMIT_S), nodes.summary()
        return time.monotonic() - start_s

    with contextlib.ExitStack() as stack:
        observer = stack.enter_context(GraphObserver(domain))
        nodes = NodeObserver(observer, truth)
        for name, package in NODES.items():
            options = ["--ros-args", "--params-file", str(tmp_path / "suite.yaml"), "-p", "use_sim_time:=true"]
            options += ["-p", f"black_box:={tmp_path / name}.mcap"]
            command = ["taskset", "-c", str(core), *executable(package, name), *options]
            stack.enter_context(LiveProcess(command, tmp_path / f"{name}.log", environment))
        assert observer.spin_until(lambda: set(NODES) <= set(observer.node.get_node_names()), LIMIT_S)
        with busy_core(core), play(FASTEST):
            reported = waited_s(observer, lambda: set(NODES) <= set(nodes.behind))
            shown = waited_s(observer, lambda: {level for level, _ in nodes.overload.values()} == {2})
            for node, (_, text) in nodes.overload.items():
                assert re.fullmatch(BEHIND.format(node=node), text), text
            cut = waited_s(observer, lambda: {"ins", "star.bow", "encoder", "lights"} <= set(nodes.behind))
            for claims in nodes.claims.values():
                claims.clear()
            waited_s(observer, lambda: all(Status.INVALID in claims for claims in nodes.claims.values()))
        for claims in nodes.claims.values():
            claims.clear()
        nodes.rejections.clear()
        with play(USUAL):
            valid = waited_s(observer, lambda: all(Status.VALID in claims for claims in nodes.claims.values()))
            ok = waited_s(observer, lambda: {level for level, _ in nodes.overload.values()} == {0})
    print(f"behind after {reported:.1f} s, shown {shown:.1f} s later, all cut {cut:.1f} s later")
    print(f"VALID after {valid:.1f} s, over {ok:.1f} s later")
    assert nodes.excluded == set()
    assert nodes.worst_sigmas < MOST_SIGMAS
    for name in NODES:
        command = [*executable("ship_replay", "replay"), str(tmp_path / f"{name}.mcap"), "--verify"]
        verified = subprocess.run(command, capture_output=True, text=True, timeout=300.0, check=False)
        assert verified.returncode == 0, verified.stdout + verified.stderr
        assert "overload" in verified.stdout
