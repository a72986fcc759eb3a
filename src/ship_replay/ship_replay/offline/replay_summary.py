"""Result of a replay."""

from collections import Counter
from dataclasses import dataclass, field

from ship_replay.offline.exclusion_history import INTEGRITY_TOPICS, ExclusionHistory
from ship_replay.offline.message_times import LogDelays, MessageTimes
from ship_replay.offline.status_history import StatusHistory


@dataclass
class ReplaySummary:
    """Result of a replay.

    Attributes:
        inputs: relative topic → number of messages processed.
        outputs: topic → number of messages written, truth included.
        rejected: input topic, after the node's name if several nodes are replayed → reason → number of messages not
            used.
        accepted_with_note: the same topics → reason → number of messages used with a note, or of message parts not
            used.
        undecodable: relative topic → number of messages that do not match their type.
        status_histories: topic with a status → its status history.
        exclusions: topic of Integrity messages → history of the reported exclusions.
        times: relative topic → stamps and arrival times of its messages.
        log_delays: statistics of log time minus stamp.
        reasons: reasons for which outputs were INVALID or DEGRADED, one line each.
        absent: optional input topics that are not in the bag.
        problems: nodes that are not replayed, and problems of the bag, one line each.
        duration_s: length of the bag, s.
        elapsed_s: processing time, s.
    """

    inputs: Counter[str] = field(default_factory=Counter)
    outputs: Counter[str] = field(default_factory=Counter)
    rejected: dict[str, dict[str, int]] = field(default_factory=dict)
    accepted_with_note: dict[str, dict[str, int]] = field(default_factory=dict)
    undecodable: Counter[str] = field(default_factory=Counter)
    status_histories: dict[str, StatusHistory] = field(default_factory=dict)
    exclusions: dict[str, ExclusionHistory] = field(default_factory=dict)
    times: dict[str, MessageTimes] = field(default_factory=dict)
    log_delays: LogDelays = field(default_factory=LogDelays)
    reasons: list[str] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    duration_s: float = 0.0
    elapsed_s: float = 0.0

    def status_lines(self) -> list[str]:
        """Return each output's status history, with the exclusions and reinstatements of sources below it."""
        lines = []
        for topic, status_history in sorted(self.status_histories.items()):
            lines += status_history.lines(topic)
            history = self.exclusions.get(INTEGRITY_TOPICS.get(topic, ""))
            if history is not None and status_history.spans:
                lines += history.lines(status_history.spans[0].start_ns)
        return lines
