"""Alerts of a suite, raised from its messages and saved in a file, so that no alert is lost if the node crashes.

No ROS is used.
"""

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.stamps import NS_PER_S
from ship_node.saved_files.saved_document import DISK, Files
from ship_watch.alerts.alert_conditions import ComputerState, NodeStatus, conditions
from ship_watch.alerts.alerts import AlertChange, AlertList
from ship_watch.safety.functions import DiagnosticEntry, diagnostic_entries
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import AlertEntry, SuiteState
from ship_watch.topics import has_room

MAX_PAUSE_NS = 5 * NS_PER_S
"""Maximum time between two updates, ns. A longer time counts as sleep of the computer, and the data are reset."""

MAX_STATUS_AGE_NS = 5 * NS_PER_S
"""Maximum age of a node's diagnostic status, ns; nodes publish it once a second."""

MAX_STATUSES = 2000
"""Maximum number of diagnostic statuses."""

_DISK_PERIOD_NS = 10 * NS_PER_S
_FORMAT, _VERSION = "ship_alerts", 1


class AlertManager:
    """Monitors a suite, raises its alerts and saves them.

    Args:
        limits: limits of the ship.
        state_file: file of the alerts, read at once if it exists; None for no file.
        now_ns: steady time, ns.
        log_problem: called with one line about a problem with the file or the disk.
        files: reader and writer of files.

    Attributes:
        suite_state: state of the suite at the last update.
    """

    def __init__(
        self,
        limits: Limits,
        state_file: Path | None,
        now_ns: int,
        log_problem: Callable[[str], None],
        files: Files = DISK,
    ) -> None:
        self._limits, self._state_file, self._log_problem, self._files = limits, state_file, log_problem, files
        self._monitor = SuiteMonitor(limits)
        self._statuses: dict[tuple[str, str], tuple[NodeStatus, int]] = {}
        self._disk_free_gb, self._disk_checked_ns = math.nan, now_ns - _DISK_PERIOD_NS
        self._updated_ns = now_ns
        self._is_unsaved = False
        self._alert_list = self._read_alerts(now_ns)
        self.suite_state: SuiteState = self._monitor.current_state(now_ns)

    @property
    def alerts(self) -> tuple[AlertEntry, ...]:
        """Alerts that are not NORMAL, the most urgent first."""
        return self._alert_list.alerts

    def process_message(self, topic: str, message: Any, arrival_ns: int) -> None:
        """Process a message; ``topic`` is relative to the namespace, ``arrival_ns`` is a steady time."""
        self._monitor.process_message(topic, message, arrival_ns)

    def process_status(self, status: NodeStatus, arrival_ns: int) -> None:
        """Process a diagnostic status of a node."""
        key = (status.node, status.name)
        if has_room(self._statuses, key, "diagnostic status", MAX_STATUSES):
            self._statuses[key] = status, arrival_ns

    def reset(self, now_ns: int) -> None:
        """Reset all data except the alerts, after the suite's time went back or the computer slept."""
        self._monitor.reset()
        self._statuses.clear()
        self._alert_list = AlertList(self._limits.alerts, self._alert_list.serialise(), now_ns)
        self._updated_ns = now_ns

    def update(self, now_ns: int, clock_ns: int) -> tuple[AlertChange, ...]:
        """Update the alerts and save changes; return the changes.

        Args:
            now_ns: steady time, ns.
            clock_ns: UTC of the computer's clock, ns; used until the suite has a time.
        """
        if now_ns - self._updated_ns > MAX_PAUSE_NS:
            self.reset(now_ns)
        self._updated_ns = now_ns
        self.suite_state = self._monitor.current_state(now_ns)
        found = conditions(self.suite_state, self._limits, self._computer_state(now_ns))
        return self._save_changes(self._alert_list.update(found, now_ns, self._utc_ns(clock_ns)))

    def acknowledge(self, id_: str, instance: int, clock_ns: int) -> tuple[AlertChange | None, str]:
        """Acknowledge one instance of an alert; return the change (None if nothing changes) and the result in words."""
        change, text = self._alert_list.acknowledge(id_, instance, self._utc_ns(clock_ns))
        if change is not None:
            self._save_changes((change,))
        return change, text

    def silence(self, now_ns: int, clock_ns: int) -> tuple[AlertChange, ...]:
        """Silence all sounding alerts for the time ``silence_s`` of the limits; return the changes."""
        return self._save_changes(self._alert_list.silence(now_ns, self._utc_ns(clock_ns)))

    def diagnostic_entries(self) -> tuple[DiagnosticEntry, ...]:
        """Return the functions of the suite and their inputs at the last update, as diagnostic entries."""
        return diagnostic_entries(self.suite_state, self._limits)

    def _utc_ns(self, clock_ns: int) -> int:
        return self.suite_state.utc_ns or clock_ns

    def _computer_state(self, now_ns: int) -> ComputerState:
        if self._limits.machine.disk_path and now_ns - self._disk_checked_ns >= _DISK_PERIOD_NS:
            self._disk_checked_ns = now_ns
            try:
                self._disk_free_gb = shutil.disk_usage(self._limits.machine.disk_path).free / 1e9
            except OSError as problem:
                # A missing disk has no free space.
                self._disk_free_gb = 0.0
                self._log_problem(f"disk {self._limits.machine.disk_path}: {problem.strerror}")
        self._statuses = {
            key: (status, received_ns)
            for key, (status, received_ns) in self._statuses.items()
            if now_ns - received_ns <= MAX_STATUS_AGE_NS
        }
        return ComputerState(tuple(status for status, _ in self._statuses.values()), self._disk_free_gb)

    def _read_alerts(self, now_ns: int) -> AlertList:
        """Return the alerts of the file; an empty list if there is no file or the file cannot be read."""
        try:
            if self._state_file is not None:
                document: dict[str, Any] = json.loads(self._files.read(self._state_file))
                if (document["format"], document["version"]) != (_FORMAT, _VERSION):
                    raise ValueError(f"expected format {_FORMAT}, version {_VERSION}")
                return AlertList(self._limits.alerts, document["alerts"], now_ns)
        except FileNotFoundError:
            pass
        except (OSError, ValueError, TypeError, KeyError) as problem:
            text = f"saved alerts cannot be read, the list of alerts starts empty: {problem}"
            self._log_problem(str(BadInput(text, file=self._state_file)))
        return AlertList(self._limits.alerts, (), now_ns)

    def _save_changes(self, changes: tuple[AlertChange, ...]) -> tuple[AlertChange, ...]:
        """Write the file if there are changes or the last write failed; return the changes."""
        if self._state_file is not None and (changes or self._is_unsaved):
            document = {"format": _FORMAT, "version": _VERSION, "alerts": self._alert_list.serialise()}
            try:
                self._files.write(self._state_file, json.dumps(document, indent=1).encode())
                self._is_unsaved = False
            except OSError as problem:
                if not self._is_unsaved:
                    self._log_problem(
                        f"{self._state_file}: alerts cannot be saved: {problem.strerror}; retried at each update"
                    )
                self._is_unsaved = True
        return changes
