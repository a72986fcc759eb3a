"""Monitored voyages with faults: a bag with injected faults is replayed, and its outputs are given to the monitor.

Times of the faults and of the results are seconds after the first message of the bag.
"""

import fcntl
import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ship_bags.mcap.bag_reader import read_bag
from ship_replay.commands.replay import main as replay
from ship_simulation.inject_command import main as inject
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import Event, Presence, SuiteState
from ship_watch.topics import monitored_topic

BAGS = Path(__file__).parents[2] / "bags"
STEP_NS = 100_000_000

FAULTS = {
    "demo": (
        "knock: {topic: star/starboard/horizon_attitude, kind: knock, start_s: 15.0, end_s: 20.0, right_arcsec: 50.0}, "
        "step: {topic: ins/imu, kind: bias, start_s: 28.0, up_arcsec: 100.0}, "
        "silent: {topic: star/fore/horizon_attitude, kind: drop, start_s: 38.0, end_s: 44.0}"
    ),
    "theodolite": (
        "float: {topic: beacon/a/baseline, kind: corrupt, field: fix, value: 3, start_s: 10.0, end_s: 14.0}, "
        "swap: {topic: theodolite/beacons, kind: swap, start_s: 20.0, end_s: 25.0}, "
        "silent: {topic: theodolite/encoder, kind: drop, start_s: 31.0, end_s: 36.0}"
    ),
}
TIMEOUT_S = 2.0
"""A message is overdue after three periods, and at least 2 s (docs/explanation/watch.md): until then it may be late.
Three periods of the star sensor are 0.6 s, of the encoder 0.06 s.
"""

# Earliest detection of each fault: its first wrong measurement, or the timeout after the last message.
DETECTABLE_S = {
    "demo": {"star.starboard": 15.117, "ins": 28.0, "star.fore": 37.933 + TIMEOUT_S},
    "theodolite": {"baselines": 10.0, "lights": 20.0, "encoder": 30.982 + TIMEOUT_S},
}
END_S = {"demo": 43.0, "theodolite": 35.0}
DETECTION_LIMIT_S = 2.0
TIMEOUT_DETECTION_LIMIT_S = 0.5
"""Maximum time from a timeout to its detection, s. No further message is needed: the next update, within 0.2 s, detects
the timeout, and the alert is raised 0.2 s later (AlertTimes.raise_after_s). Measured: 0.0 s and 0.2 s.
"""
TIMED_OUT_SOURCES = ("star.fore", "encoder")


def detection_limit_s(source: str) -> float:
    """Return the time within which a source must be named in a recording, without process delays."""
    return TIMEOUT_DETECTION_LIMIT_S if source in TIMED_OUT_SOURCES else DETECTION_LIMIT_S


@dataclass
class MonitoredVoyage:
    """Monitored states of a voyage.

    Attributes:
        monitor: monitor after the last message.
        start_ns: log time of the first message.
        end_ns: log time of the last message.
        out_s: source → times at which it became OUT, s.
        back_s: source → times at which it was IN again, s.
        shown_sources: source → its states at the times of ``out_s``.
        root_causes: (time, name) of each source that became OUT by a fault of its own, s.
        state_at: whole second → suite state.
    """

    monitor: SuiteMonitor
    start_ns: int
    end_ns: int = 0
    out_s: dict[str, list[float]] = field(default_factory=dict)
    back_s: dict[str, list[float]] = field(default_factory=dict)
    shown_sources: dict[str, list[Any]] = field(default_factory=dict)
    root_causes: list[tuple[float, str]] = field(default_factory=list)
    state_at: dict[float, SuiteState] = field(default_factory=dict)

    def events(self, kind: str) -> list[tuple[float, str]]:
        """Return (time, text) of all events of a kind, the oldest first."""
        found: list[Event] = [event for event in self.last_state().events if event.kind == kind]
        return [((event.utc_ns - self.start_ns) * 1e-9, event.text) for event in reversed(found)]

    def last_state(self) -> SuiteState:
        """Return the suite state at the end."""
        return self.monitor.current_state(self.end_ns)


def replay_with_faults(folder: Path, bag: str, faults: str = "") -> tuple[Path, Path]:
    """Return a bag of the repository with faults (YAML of the group ``faults``), and the suite's outputs for it.

    The bags are created once in a run of the tests, by the first worker that needs them, and must not be changed.
    ``folder`` is a temporary folder of pytest, inside the folder of the run.
    """
    run = folder.parents[1] if "PYTEST_XDIST_WORKER" in os.environ else folder.parent
    place = run / f"replayed_{bag}_{hashlib.sha256(faults.encode()).hexdigest()[:16]}"
    given, result = BAGS / f"{bag}.mcap", place / "out.mcap"
    place.mkdir(exist_ok=True)
    with (place / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if faults:
            given = _inject_faults(place, given, faults)
        if not result.exists():
            assert replay([str(given), "--out", str(place / "part.mcap")]) == 0
            (place / "part.mcap").rename(result)
    return given, result


def _inject_faults(place: Path, given: Path, faults: str) -> Path:
    """Return the bag with these faults."""
    faulty = place / "in.mcap"
    if not faulty.exists():
        (place / "faults.yaml").write_text(f"faults: {{{faults}}}\n")
        named = ["--faults", str(place / "faults.yaml"), "--out", str(place / "part.mcap"), "--seed", "1"]
        assert inject([str(given), *named]) == 0
        (place / "part.mcap").rename(faulty)
    return faulty


def records(*paths: Path) -> Iterator[tuple[int, str, Any]]:
    """Return (log time, topic, message) of the monitored topics of bags of one voyage, by time."""
    found = []
    for path in paths:
        with read_bag(path) as bag:
            wanted = [topic for topic, type_name in bag.topics.items() if monitored_topic(topic, type_name)]
            found += [(record.log_time_ns, record.topic, record.decode()) for record in bag.records(wanted)]
    return iter(sorted(found, key=lambda entry: entry[0]))


def monitor_voyage(*paths: Path) -> MonitoredVoyage:
    """Return a voyage monitored at 10 Hz; ``paths`` are the bag of its outputs and, optionally, the bag of inputs."""
    voyage: MonitoredVoyage | None = None
    due_ns, before = 0, {}
    for time_ns, topic, message in records(*paths):
        if voyage is None:
            voyage, due_ns = MonitoredVoyage(SuiteMonitor(), time_ns), time_ns
        while due_ns <= time_ns:
            picture = voyage.monitor.current_state(due_ns)
            before = _record_state(voyage, picture, before, (due_ns - voyage.start_ns) * 1e-9)
            due_ns += STEP_NS
        voyage.monitor.process_message(topic, message, time_ns)
        voyage.end_ns = time_ns
    assert voyage is not None
    return voyage


def _record_state(
    voyage: MonitoredVoyage, state: SuiteState, previous: dict[str, Presence], time_s: float
) -> dict[str, Presence]:
    """Record a suite state; return the presence of each source in it."""
    if abs(time_s - round(time_s)) < 1e-6:
        voyage.state_at[float(round(time_s))] = state
    for source in state.sources:
        previous_presence = previous.get(source.name, Presence.IN)
        if source.presence is Presence.OUT and previous_presence is not Presence.OUT:
            voyage.out_s.setdefault(source.name, []).append(time_s)
            voyage.shown_sources.setdefault(source.name, []).append(source)
            if not source.because_of:
                voyage.root_causes.append((time_s, source.name))
        elif source.presence is Presence.IN and previous_presence is Presence.OUT:
            voyage.back_s.setdefault(source.name, []).append(time_s)
    return {source.name: source.presence for source in state.sources}
