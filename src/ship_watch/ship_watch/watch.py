"""State of a suite at any time, from its messages.

The caller passes each message to :meth:`SuiteMonitor.process_message` and gets the state from
:meth:`SuiteMonitor.current_state`. Times of arrival are the caller's: live those of a steady clock, for a bag the log
times. Safety and events are evaluated ten times a second of that time, however often the state is requested, so that a
bag gives the same events as the live messages.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_estimation.outcome import Status
from ship_estimation.refusals import Reason
from ship_watch.behind import BehindBook
from ship_watch.events import SETTLED_NS, EventBook, alerts_shown
from ship_watch.history import History
from ship_watch.history_keeper import HistoryKeeper
from ship_watch.limits import Limits
from ship_watch.mounting_shifts import MountingShifts
from ship_watch.names import has_room
from ship_watch.outputs import AttitudeRecord, OutputRecord, PointingRecord
from ship_watch.picture import (
    ANGLES,
    ITS_NODE,
    AlertShown,
    AngleShown,
    SuiteState,
    Safety,
    SourceShown,
    SourceStanding,
)
from ship_watch.published_state import PublishedState, published_state
from ship_watch.sources import STAR_INNOVATION, SourceBook, first_faulty_source, newest_age_s
from ship_watch.states import COUNTDOWN, AngleClaim, SafetyHysteresis, TimeOver, angle_word
from ship_watch.topics import reading_node, source_of_topic, monitored_topic

STEP_NS = 100_000_000
"""Period at which safety and events are evaluated, ns."""

LONGEST_GAP_NS = 120 * NS_PER_S
"""Longest gap without messages that is evaluated, ns: after it all ages are over their limits."""

CLOCK_MET_NS = NS_PER_S // 10
"""Distance of an output's stamp from the suite's time that confirms this time, ns."""

CLOCK_TIMEOUT_NS = 5 * NS_PER_S
"""Time without a confirming output after which the suite's time is set again, ns."""

BACK_NS = NS_PER_S
"""Step back of an output's stamp that resets the history, ns: a bag is played in a loop."""

_SHIP_SOURCES = ("ins", "star", "reference", "gnss", "weather")
_POINTING_SOURCES = ("encoder", "lights", "baselines", "ship_attitude")
_SHIP_NEEDS = ("ins", "star", "reference")
_POINTING_NEEDS = ("encoder", "ship_attitude")
"""Sources without which there is no output; without the others its quality is only reduced."""


class SuiteMonitor:
    """Evaluates the outputs of a suite against the limits of the ship.

    Args:
        limits: limits of the ship.
        make_recorder: makes the recorder of the history; a user that plots less passes one that records less.
    """

    def __init__(self, limits: Limits | None = None, keeper: Callable[[], HistoryKeeper] = HistoryKeeper) -> None:
        self.limits = limits or Limits()
        self._make_keeper = keeper
        self._takers: dict[str, Callable[[Any, int], None]] = {}
        self._alerts: tuple[AlertShown, ...] | None = None
        self._published: PublishedState | None = None
        self._forget()

    @property
    def history(self) -> History:
        """History for plots; a new object after a reset."""
        return self._keeper.history

    def reset(self) -> None:
        """Reset everything except the alerts, as when a bag is played in a loop."""
        self._forget()

    def forget_alerts(self) -> None:
        """Clear alerts and published state after the end of the alert node."""
        self._alerts, self._published = None, None

    def _forget(self) -> None:
        self._keeper = self._make_keeper()
        self._takers.clear()
        self._attitude, self._pointing = AttitudeRecord(self.limits), PointingRecord(self.limits)
        self._book = SourceBook(self.limits)
        self._behind = BehindBook()
        self._mountings = MountingShifts()
        self._words = {name: SafetyHysteresis(self.limits.better_after_s) for name in ANGLES}
        self._over = {name: TimeOver() for name in ANGLES}
        self._events = EventBook()
        self._newest_ns, self._utc_offset_ns, self._offset_met_ns = 0, 0, 0
        self._published = None
        self._shown_words: dict[str, Safety] = {}
        self._first_ns: int | None = None
        self._evaluated_ns: int | None = None

    # -- messages -------------------------------------------------------------------------------------------

    def take(self, topic: str, message: Any, arrival_ns: int) -> None:
        """Process one message; topics that are not monitored are ignored.

        Args:
            topic: name of its topic, relative to the namespace of the suite.
            message: the message, with the fields of its type as attributes.
            arrival_ns: time of its arrival, caller's steady time, ns.
        """
        taker = self._takers.get(topic) or self._taker(topic)
        if taker is not None:
            self._takers[topic] = taker
            self._evaluate_until(arrival_ns)
            with np.errstate(all="ignore"):  # invalid values become NaN, which fails every comparison
                taker(message, arrival_ns)

    def take_state(self, message: Any, arrival_ns: int) -> None:
        """Process a SuiteState message: while such messages arrive, angles and sources are taken from them.

        Raises:
            ValueError: the message contains a safety or a presence that does not exist.
        """
        self._evaluate_until(arrival_ns)
        self._published = published_state(message, arrival_ns)

    def _taker(self, topic: str) -> Callable[[Any, int], None] | None:
        """Return the handler of a topic's messages; None if it is not monitored."""
        if monitored_topic(topic) is None or not has_room(self._takers, topic, "topic"):
            return None
        keeper = self._keeper
        first, _, last = topic.rpartition("/")
        takers: dict[str, Callable[[Any, int], None]] = {
            "attitude": lambda message, now_ns: self._take_output(self._attitude, message, now_ns),
            "pointing": lambda message, now_ns: self._take_output(self._pointing, message, now_ns),
            "innovation": lambda message, now_ns: self._take_innovation(topic, message, now_ns),
            "integrity": lambda message, now_ns: self._take_integrity(topic, message, now_ns),
            "input_health": self._take_health,
            "alerts": self._take_alerts,
            "error_budget": lambda message, _: keeper.note_budget(topic, message),
            "error_arcsec": lambda message, _: keeper.note_error(topic, message),
            "alignment": functools.partial(self._take_alignment, topic),
            "calibration": lambda message, _: keeper.note_parameters(topic, message),
        }
        if first == "truth":
            return lambda message, _: keeper.note_truth(topic, message)
        return takers.get(last, functools.partial(self._take_seen, topic))

    def _take_output(self, output: OutputRecord, message: Any, now_ns: int) -> None:
        stamp_ns = ns_from_stamp(message.header.stamp)
        if message.status != Status.INVALID and stamp_ns < output.stamp_ns - BACK_NS:
            self._forget()
            self._events.add("node", "time", "time went back: history cleared", stamp_ns)
            output = self._attitude if output.topic == self._attitude.topic else self._pointing
        self._note_time(stamp_ns, now_ns)
        changes = output.note(message, stamp_ns, now_ns)
        for kind, text in changes:
            self._events.add(kind, output.topic, text, stamp_ns)
        self._book.record_arrival(output.topic, now_ns)
        self._keeper.note_output(output.topic, message, stamp_ns)

    def _take_innovation(self, topic: str, message: Any, now_ns: int) -> None:
        if message.reason == Reason.BEHIND:
            self._behind.note(message, now_ns)
            return
        source = self._book.note_innovation(topic, message, now_ns)
        if source and topic != STAR_INNOVATION:
            self._keeper.note_innovation(source, message, now_ns)

    def _take_alignment(self, topic: str, message: Any, _now_ns: int) -> None:
        self._keeper.note_parameters(topic, message)
        self._mountings.note_alignment(message)

    def _take_seen(self, topic: str, message: Any, now_ns: int) -> None:
        self._book.record_arrival(topic, now_ns)
        if topic.endswith("/solution"):
            self._book.note_solution(source_of_topic(topic), message, now_ns)
        self._keeper.note_seen(topic, message, now_ns)

    def _take_integrity(self, topic: str, message: Any, now_ns: int) -> None:
        (self._attitude if topic.startswith("ship/") else self._pointing).note_integrity(message, now_ns)
        self._book.note_integrity(topic, message, ns_from_stamp(message.header.stamp))

    def _take_health(self, message: Any, now_ns: int) -> None:
        self._note_time(ns_from_stamp(message.header.stamp), now_ns)
        has_started = self._book.note_health(message, now_ns)
        if has_started and self._first_ns is not None and now_ns - self._first_ns > SETTLED_NS:
            self._events.add_node_start(reading_node(str(message.topic)), ns_from_stamp(message.header.stamp))

    def _take_alerts(self, message: Any, now_ns: int) -> None:
        alerts = alerts_shown(message)
        self._events.add_alert_changes(self._alerts or (), alerts, ns_from_stamp(message.header.stamp))
        self._alerts = tuple(sorted(alerts, key=lambda alert: alert.urgency))

    def _note_time(self, stamp_ns: int, now_ns: int) -> None:
        """Update the suite's time: the stamp of the output with the least delay, plus the time since its arrival.

        If all outputs are older for some seconds, that stamp was wrong or the clock was set: the time is set again.
        """
        offset_ns = stamp_ns - now_ns
        if offset_ns > self._utc_offset_ns or not self._newest_ns or now_ns - self._offset_met_ns > CLOCK_TIMEOUT_NS:
            self._utc_offset_ns, self._offset_met_ns = offset_ns, now_ns
        elif offset_ns > self._utc_offset_ns - CLOCK_MET_NS:
            self._offset_met_ns = now_ns
        self._newest_ns = max(self._newest_ns, stamp_ns)

    # -- state ----------------------------------------------------------------------------------------------

    def current_state(self, now_ns: int) -> SuiteState:
        """Return the state at the caller's time; it does not depend on how often it is requested."""
        self._evaluate_until(now_ns)
        utc_ns = now_ns + self._utc_offset_ns
        sources = [self._with_own_news(each, now_ns) for each in self._book.shown(self._standings(now_ns), now_ns)]
        shown = [self._shown(name, claim, now_ns) for name, claim in self._claims(sources, now_ns).items()]
        suite_state = SuiteState(
            utc_ns=utc_ns if self._newest_ns else 0,
            angles=tuple(shown),
            ages_s={
                "stars": newest_age_s("star", sources, self._attitude.star_age_s(now_ns)),
                "lights": newest_age_s("lights", sources, self._book.used_age_s("lights", now_ns)),
                "ins": newest_age_s("ins", sources, self._attitude.ins_age_s(self._book.age_s("ins", now_ns), now_ns)),
            },
            pointing_by=self._pointing.by,
            horizon=self._attitude.horizon,
            sources=tuple(sources),
            alerts=self._alerts,
            inputs=tuple(reports.shown(now_ns) for reports in self._book.inputs),
            events=tuple(self._events.events),
            waiting_for="" if self._attitude.is_received else self._attitude.topic,
        )
        published = self._current_state(now_ns)
        return suite_state if published is None else published.shown_in(suite_state, now_ns)

    def _current_state(self, now_ns: int) -> PublishedState | None:
        """Return the published state if it is current; None without an alert node, or if its last state is too old."""
        published = self._published
        return published if published is not None and published.is_current(now_ns) else None

    def _with_own_news(self, source: SourceShown, now_ns: int) -> SourceShown:
        """Return a source with data from the outputs: its mounting shift, and the age of the INS."""
        shift = self._mountings.shift_of(source.name, now_ns + self._utc_offset_ns)
        age_s = self._attitude.ins_age_s(source.age_s, now_ns) if source.name == "ins" else source.age_s
        return replace(source, mounting_shift=shift, age_s=age_s)

    def _evaluate_until(self, now_ns: int) -> None:
        """Evaluate at each step of time until now, before a message that arrives now is processed."""
        if self._evaluated_ns is None:
            self._evaluated_ns = self._first_ns = now_ns - now_ns % STEP_NS
        if now_ns - self._evaluated_ns > LONGEST_GAP_NS:
            self._evaluated_ns += (now_ns - self._evaluated_ns - LONGEST_GAP_NS) // STEP_NS * STEP_NS
        while self._evaluated_ns + STEP_NS <= now_ns:
            self._evaluated_ns += STEP_NS
            self._evaluate(self._evaluated_ns)

    def _standings(self, now_ns: int) -> list[SourceStanding]:
        return self._behind.attributed(self._book.standings(now_ns, self._utc_offset_ns), now_ns)

    def _evaluate(self, now_ns: int) -> None:
        """Evaluate sources and angles and record their events; a current published state takes their place."""
        sources, utc_ns = self._standings(now_ns), now_ns + self._utc_offset_ns
        words: dict[str, tuple[Safety, str]] = {}
        for name, claim in self._claims(sources, now_ns).items():
            self._over[name].note(claim, now_ns)
            if self._output(name).is_received:
                now = angle_word(claim)
                self._words[name].note(now, now_ns)
                shown = self._words[name].shown_word(now, now_ns)
                words[name] = shown.word, shown.reason(now, claim.limit)
        are_old = {name for name in ANGLES if self._output(name).is_old(now_ns)}
        if (published := self._current_state(now_ns)) is not None:
            sources = list(published.sources)
            words = {angle.name: (angle.safety, angle.reason) for angle in published.angles if angle.stamp_ns}
            are_old = {angle.name for angle in published.angles if angle.is_old}
        self._events.add_source_changes(sources, utc_ns)
        for name, text in self._mountings.note_sources(sources, utc_ns):
            self._events.add("source", name, text, utc_ns)
        for name, (word, reason) in words.items():
            before = self._shown_words.get(name)
            if word is not before:
                self._shown_words[name] = word
                change = word.name if before is None else f"{before.name} → {word.name}"
                why = reason.partition(COUNTDOWN)[0]
                self._events.add("state", name, f"{name} {change}" + (f", {why}" if why else ""), utc_ns)
        if self._newest_ns:
            recorded = {name: None if name in are_old or name not in words else words[name][0] for name in ANGLES}
            self._keeper.note_words(utc_ns, recorded)

    def _claims(self, sources: Sequence[SourceStanding], now_ns: int) -> dict[str, AngleClaim]:
        """Return the data for the safety of each angle; those of a theodolite only if there is one.

        An output that is old while a node has stopped reporting has stopped with that node: no source is its cause.
        """
        has_node_stopped = any(source.because_of == ITS_NODE for source in sources)
        ship = first_faulty_source(sources, _SHIP_SOURCES if self._attitude.is_claimed(now_ns) else _SHIP_NEEDS)
        claims = {name: self._claim(name, ship, now_ns) for name in ANGLES[:3]}
        if self._pointing.is_received or self._book.has_theodolite:
            needed = _POINTING_SOURCES if self._pointing.is_claimed(now_ns) else _POINTING_NEEDS
            faulty_source = first_faulty_source(sources, needed) or ship
            claims |= {name: self._claim(name, faulty_source, now_ns) for name in ANGLES[3:]}
        if has_node_stopped:
            claims = {name: replace(claim, guilty=None) if claim.is_old else claim for name, claim in claims.items()}
        return claims

    def _claim(self, name: str, faulty_source: SourceStanding | None, now_ns: int) -> AngleClaim:
        output, beacons = self._output(name), self._book.beacon_count
        behind = self._behind.overload_text(now_ns, output is self._pointing, self._book.reads(self._attitude.topic))
        return AngleClaim(
            topic=output.topic,
            is_received=output.is_received,
            is_old=output.is_old(now_ns),
            value=output.values.get(name, math.nan),
            accuracy_95=output.accuracies_95.get(name, math.nan),
            limit=self.limits.angle_limit(name),
            unsafe_factor=self.limits.unsafe_factor,
            status=output.status,
            diagnosis_hint=output.diagnosis_hint(now_ns, beacons),
            is_lessened=output.is_lessened(beacons),
            protection=output.protection(name, now_ns),
            faulty_source=None if behind else faulty_source,
            behind=behind,
        )

    def _shown(self, name: str, claim: AngleClaim, now_ns: int) -> AngleShown:
        output, hysteresis, now = self._output(name), self._words[name], angle_word(claim)
        shown = hysteresis.shown_word(now, now_ns)
        word, is_held = shown.word, hysteresis.word is shown.word
        return AngleShown(
            name=name,
            value=claim.value,
            accuracy_95=claim.accuracy_95,
            limit=claim.limit,
            protection_level=claim.protection.level,
            safety=word,
            reason=shown.reason(now, claim.limit),
            age_s=output.age_s(now_ns),
            is_old=claim.is_old,
            stamp_ns=output.stamp_ns,
            since_ns=(hysteresis.since_ns if is_held else now_ns) + self._utc_offset_ns if claim.is_received else 0,
            because_of=claim.faulty_source.name if claim.faulty_source is not None and word is not Safety.SAFE else "",
            over_s=self._over[name].lasted_s(now_ns),
            now=(now.word, now.reason),
        )

    def _output(self, name: str) -> OutputRecord:
        return self._attitude if name in ANGLES[:3] else self._pointing
