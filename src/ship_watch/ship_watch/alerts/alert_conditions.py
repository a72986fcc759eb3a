"""Situations of a suite for which alerts are raised, and the priorities of these alerts.

A source that is OUT due to a fault of its own has one alert. The alert names the functions that are over their limits
due to the source, and has at least the priority of each affected function. An output with data has an alert of its own
only if no alert of at least the same priority explains the situation.
docs/explanation/alerts.md contains the table of alerts.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from ship_geometry.rotations import ARCSEC
from ship_watch.alerts.alerts import Condition
from ship_watch.safety.functions import ATTITUDE, POINTING, FunctionState, functions
from ship_watch.safety.limits import InputLimits, Limits
from ship_watch.suite_state import CAUSE_NODE, Presence, Priority, SourceDetails, SuiteState
from ship_watch.value_texts import fault_text, without_changing_figures

STARS_OUT = "stars.out"

_SOURCE_PRIORITY = {
    "ins": Priority.WARNING,
    "star": Priority.WARNING,
    "reference": Priority.WARNING,
    "encoder": Priority.WARNING,
    "lights": Priority.CAUTION,
    "baselines": Priority.CAUTION,
    "ship_attitude": Priority.CAUTION,
    "gnss": Priority.CAUTION,
    "weather": Priority.CAUTION,
}
"""Kind of source → priority of its alert while no function is affected. Lights are absent while the drones are on deck,
and the last fix and weather values stay valid for a while."""

_EXTERNAL_REASONS = ("no stars", "no lights")
"""Reasons why a source is OUT without a defect, due to clouds, daylight, or drones on deck."""

_LATE_ENDING = ": late"
"""Ending of the reason of a source whose data arrive too late to be used. The alert's value is then the delay of the
data."""

_NO_DATA_ENDINGS = ("no data", "never received", "not reported")
"""Endings of reasons for which the alert's value is the age of the source."""

_NODE_STATUSES = {
    "black box": ("box", Priority.WARNING),
    "clock": ("clock", Priority.WARNING),
    "stamps": ("stamps", Priority.WARNING),
    "name": ("name", Priority.WARNING),
    "callbacks": ("software", Priority.CAUTION),
}
"""Name of a node's status in `/diagnostics` → ending of the alert's id, priority of the alert if the level is ERROR."""

_LINE_STATUSES = {
    "sink": (Priority.WARNING, "no output to"),
    "source": (Priority.CAUTION, "no data from"),
}
"""First word of the name of an NMEA line's status → priority of an error, text; the second word names the line. Lost
functions are in the alerts of the sources whose data the line carries."""

_OVERLOAD = "overload"
"""Name of the status of a node that cannot keep up with its inputs. The alert of an output that is lost due to the
overload contains the text of this status."""

_RECOVERY, _RECOVERED = "recovery", "recovered after [s]"
"""Name of the status of a node's second estimator, and key of the recovery time, present once the second estimator was
adopted."""

_ERROR = 2


@dataclass(frozen=True)
class NodeStatus:
    """Status of a node from `/diagnostics`: name of the node, name of the status, level, text, further values."""

    node: str
    name: str
    level: int
    text: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ComputerState:
    """State of the computer and of the nodes on it.

    Attributes:
        statuses: last statuses of the nodes.
        disk_free_gb: free space of the disk that the limits name, GB; NaN if they name no disk.
    """

    statuses: tuple[NodeStatus, ...] = ()
    disk_free_gb: float = math.nan


def conditions(state: SuiteState, limits: Limits, computer: ComputerState | None = None) -> list[Condition]:
    """Return all present situations, for :meth:`ship_watch.alerts.alerts.AlertList.update`.

    The situations are derived from the safety without hold, because the list of alerts has delays of its own. An
    accuracy over its limit is a situation only after ``alerts.over_after_s``.

    Args:
        state: current state of the suite.
        limits: limits of the ship.
        computer: state of the computer; None if unknown.
    """
    function_states = functions(replace(state, angles=tuple(angle.without_hold for angle in state.angles)))
    computer = computer or ComputerState()
    return [
        *_output_conditions(state, function_states, limits),
        *_source_conditions(state, function_states),
        *_unreported_conditions(state),
        *_age_conditions(state, limits),
        *(found for source in state.sources for found in _rate_conditions(source, limits.input_limits(source.name))),
        *_clock_conditions(state, limits),
        *_node_conditions(computer.statuses, limits),
        *_disk_conditions(computer, limits),
    ]


def _output_conditions(
    suite_state: SuiteState, function_states: tuple[FunctionState, ...], limits: Limits
) -> Iterable[Condition]:
    """Yield the situations of outputs without data, and of functions that are not SAFE.

    A source that is OUT may explain a function that is not SAFE.
    """
    outs = (STARS_OUT, *(f"{source.name}.out" for source in suite_state.sources))
    for output, topic in ((ATTITUDE, "ship/attitude"), (POINTING, "theodolite/pointing")):
        members = [one for one in function_states if one.output == output and one.safety]
        above = () if output == ATTITUDE else ("attitude.silent", "attitude.degraded")
        if missing := [one for one in members if one.is_output_missing or math.isinf(one.angle.age_s)]:
            never = all(math.isinf(one.angle.age_s) for one in missing)
            yield Condition(
                f"{output}.silent", Priority.WARNING if never else Priority.ALARM, "",
                f"{topic} never received" if never else _alert_text(missing, f"no data on {topic}"),
                becomes_alarm=never, may_be_startup=never, is_never_received=never,
                explained_by=above[:1] if never else (), lost_functions=_lost_functions(missing),
            )
            continue
        # A function that is over its limit but not lost counts after a while.
        least_s = limits.alerts.over_after_s
        members = [one for one in members if one.priority is not Priority.WARNING or not one.over_limit_s < least_s]
        if members:
            worst = max(members, key=lambda one: (one.priority or 0, one.accuracy_arcsec))
            priority = worst.priority or Priority.CAUTION
            yield Condition(
                f"{output}.degraded", priority, "", _alert_text(members, worst.reason), worst.accuracy_arcsec,
                worst.limit_arcsec, "arcsec", becomes_alarm=priority is Priority.WARNING,
                may_be_startup=True, explained_by=(*above, *outs), lost_functions=_lost_functions(members),
            )


def _source_conditions(suite_state: SuiteState, function_states: tuple[FunctionState, ...]) -> Iterable[Condition]:
    """Yield the situations of sources that are faulty, corrected, or reinstated with a shifted mounting.

    If all star sensors, two or more, are OUT for the same reason, one common situation explains the situation of each.
    """
    faulty = _faulty_sources(suite_state)
    stars = [source for source in suite_state.sources if source.name.startswith("star.")]
    stars_out = [source for source in faulty if source.name.startswith("star.")]
    if (
        len(stars) == len(stars_out) >= 2
        and len({without_changing_figures(source.reason) for source in stars_out}) == 1
    ):
        names = {source.name for source in stars_out}
        yield _source_out_condition(
            STARS_OUT, "", stars_out[0], [one for one in function_states if one.because_of in names], suite_state, ()
        )
    for source in faulty:
        under = (STARS_OUT,) if source in stars else ()
        affected = [one for one in function_states if one.because_of == source.name]
        yield _source_out_condition(f"{source.name}.out", source.name, source, affected, suite_state, under)
    for source in suite_state.sources:
        if source.presence is Presence.IN and source.disagreement:
            text = f"{source.name}: {source.disagreement}, corrected"
            yield Condition(f"{source.name}.mended", Priority.CAUTION, source.name, text)
        if source.presence is Presence.IN and math.isfinite(source.mounting_shift):
            shift_arcsec = source.mounting_shift / ARCSEC
            text = f"{source.name} reinstated, mounting shifted by {shift_arcsec:.0f}″"
            yield Condition(
                f"{source.name}.remounted", Priority.CAUTION, source.name, text, shift_arcsec, unit="arcsec"
            )


def _unreported_conditions(suite_state: SuiteState) -> Iterable[Condition]:
    """Yield the situations of sources whose state is unknown because the node that reads them has stopped reporting."""
    for source in suite_state.sources:
        if source.presence is Presence.OUT and source.because_of == CAUSE_NODE:
            yield Condition(
                f"{source.name}.unreported", Priority.WARNING, source.name,
                f"{source.name} unknown: the node that reads it has stopped reporting", source.age_s, unit="s",
                explained_by=("attitude.silent", "pointing.silent"),
            )


def _source_out_condition(
    id_: str,
    name: str,
    source: SourceDetails,
    affected: list[FunctionState],
    suite_state: SuiteState,
    under: tuple[str, ...],
) -> Condition:
    base = _SOURCE_PRIORITY.get(source.name.partition(".")[0], Priority.WARNING)
    if source.reason in _EXTERNAL_REASONS:
        base = Priority.CAUTION
    priority = max([base, *(one.priority for one in affected if one.priority is not None)])
    lost, cause = _lost_functions(affected), fault_text(name or "the star sensors", source.reason)
    text = _alert_text(affected, cause) if lost else cause
    value, unit = (source.residual, "sigma") if math.isfinite(source.residual) else (math.nan, "")
    if source.reason.endswith(_NO_DATA_ENDINGS):
        value, unit = source.age_s, "s"
    if source.reason.endswith(_LATE_ENDING):
        delays_s = [one.latency_s for one in suite_state.inputs if one.topic in source.topics]
        value, unit = max(delays_s, default=math.nan), "s"
    return Condition(
        id_, priority, name, text, value, unit=unit, becomes_alarm=bool(lost), explained_by=under, lost_functions=lost
    )


def _age_conditions(suite_state: SuiteState, limits: Limits) -> Iterable[Condition]:
    """Yield the situations of stars or lights not used for too long; a source that is OUT explains such a situation."""
    outs = tuple(f"{source.name}.out" for source in suite_state.sources)
    for what, limit_s, above in (
        ("stars", limits.stars_age_s, ("attitude.silent",)),
        ("lights", limits.lights_age_s, ("pointing.silent",)),
    ):
        age_s = suite_state.ages_s.get(what, math.nan)
        if math.isfinite(age_s) and age_s > limit_s:
            yield Condition(
                f"{what}.old", Priority.CAUTION, "", f"no {what} used for more than {limit_s:g} s", age_s, limit_s, "s",
                explained_by=(*above, STARS_OUT, *outs),
            )


def _rate_conditions(source: SourceDetails, limits: InputLimits) -> Iterable[Condition]:
    if source.presence is Presence.IN and source.rate_hz < limits.rate_hz:
        yield Condition(
            f"{source.name}.rate", Priority.CAUTION, source.name, f"rate of {source.name} below {limits.rate_hz:g} Hz",
            source.rate_hz, limits.rate_hz, "Hz", explained_by=(f"{source.name}.out",),
        )


def _clock_conditions(suite_state: SuiteState, limits: Limits) -> Iterable[Condition]:
    """Yield the situation of stamps in the future: the clock of an instrument or of the computer is wrong."""
    ahead = [one for one in suite_state.inputs if one.latency_s < -limits.machine.clock_offset_s]
    if ahead:
        worst = min(ahead, key=lambda one: one.latency_s)
        yield Condition(
            "clock.ahead", Priority.WARNING, "",
            f"stamps of {worst.topic} more than {limits.machine.clock_offset_s:g} s ahead of the computer's clock",
            -worst.latency_s, limits.machine.clock_offset_s, "s",
        )


def _node_conditions(statuses: Iterable[NodeStatus], limits: Limits) -> Iterable[Condition]:
    for status in statuses:
        if status.name == _RECOVERY and _RECOVERED in status.values:
            text = f"{status.node} recovered: a second estimator was adopted"
            yield Condition(
                f"{status.node}.recovered", Priority.CAUTION, "", text, float(status.values[_RECOVERED]), unit="s"
            )
        if status.level < _ERROR:
            continue
        kind, _, line = status.name.partition(" ")
        if kind in _LINE_STATUSES:
            priority, words = _LINE_STATUSES[kind]
            yield Condition(f"{status.node}.{kind}.{line}", priority, "", f"{status.node}: {words} {line}")
        if status.name == _OVERLOAD:
            yield _overload_condition(status)
        if status.name not in _NODE_STATUSES:
            continue
        ending, priority = _NODE_STATUSES[status.name]
        lost_text = status.values.get("lost", "")
        lost = int(lost_text) if lost_text.isdecimal() else 0
        if ending == "box" and 0 < lost <= limits.machine.box_lost:
            continue
        value = (float(lost), float(limits.machine.box_lost), "entries") if lost else (math.nan, math.nan, "")
        text = without_changing_figures(f"{status.node}, {status.name}: {status.text}")
        text = text.replace(f"{lost} entries", "entries")
        yield Condition(f"{status.node}.{ending}", priority, "", text, *value)


def _overload_condition(status: NodeStatus) -> Condition:
    output = POINTING if status.node == "optical_axis" else ATTITUDE
    value = float(status.values.get("behind [s]", "nan"))
    return Condition(
        f"{status.node}.{_OVERLOAD}", Priority.WARNING, "", without_changing_figures(status.text), value, unit="s",
        explained_by=(f"{output}.degraded",),
    )


def _disk_conditions(computer: ComputerState, limits: Limits) -> Iterable[Condition]:
    if computer.disk_free_gb < limits.machine.disk_free_gb:
        yield Condition(
            "disk.full", Priority.WARNING, "",
            f"less than {limits.machine.disk_free_gb:g} GB free on the disk of {limits.machine.disk_path}",
            computer.disk_free_gb, limits.machine.disk_free_gb, "GB", becomes_alarm=True,
        )


def _faulty_sources(suite_state: SuiteState) -> list[SourceDetails]:
    return [one for one in suite_state.sources if one.presence is Presence.OUT and not one.because_of]


def _alert_text(affected: Iterable[FunctionState], cause: str) -> str:
    """Return the text of an alert: the affected functions, the worst first, and the cause.

    Unchecked functions are named only if all affected functions are unchecked. An example is "Heading lost, tilt over
    its limit: no data from ins".
    """
    affected = list(affected)
    by_words: dict[str, list[str]] = {}
    for one in sorted([one for one in affected if one.is_over_limit] or affected, key=lambda one: -(one.priority or 0)):
        by_words.setdefault(one.text.partition(" ")[2], []).append(one.name)
    text = ", ".join(_joined_names(names, words) for words, names in by_words.items())
    return f"{text[:1].upper()}{text[1:]}: {cause}"


def _joined_names(names: list[str], words: str) -> str:
    if len(names) == 1:
        return f"{names[0]} {words}"
    return f"{', '.join(names[:-1])} and {names[-1]} {words.replace('its limit', 'their limits')}"


def _lost_functions(function_states: Iterable[FunctionState]) -> frozenset[str]:
    return frozenset(one.name for one in function_states if one.is_over_limit)
