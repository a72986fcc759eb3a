"""Evaluation of one run: innovations, last estimates and, if the truth is known, errors."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ship_attitude_star.messages.attitude_messages import SMOOTHED_TOPIC
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag, BagRecord, read_bag, with_bag_progress
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_bags.parameter_yaml import in_any_namespace
from ship_bags.stamps import NS_PER_S
from ship_bags.topic_names import namespace_of_outputs, relative_topics
from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_node.messages.field_checks import MessageRejected
from ship_node.parameters.parameter_file import has_section, load_config
from ship_replay.evaluation.sources import JOINT_SOLUTION, AttitudeSource, PublishedAttitude, Truth, attitude_sources
from ship_replay.evaluation.statistics import AttitudeErrors, InnovationCollector, SourceInnovations, json_text
from ship_replay.evaluation.targets import TARGET_DIRECTION, TARGET_TRUTH, TargetDirections, TargetErrors
from ship_replay.offline.adapter_chain import attachment_error
from ship_watch.orientations import ORIENTATIONS
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.messages.output_messages import SMOOTHED_POINTING_TOPIC

Config = TypeVar("Config")

_INNOVATION_TOPICS = ("ship/innovation", "theodolite/innovation", "target/innovation")
_ESTIMATES = {"ship/alignment": "alignment", "theodolite/calibration": "calibration"}
"""Topic of additional filter estimates → its name in an evaluation."""
_RESULTS = (*_INNOVATION_TOPICS, *_ESTIMATES)
_SMOOTHED = (SMOOTHED_TOPIC, SMOOTHED_POINTING_TOPIC)
_PUBLISHED = (*(orientation.topic for orientation in ORIENTATIONS), *_SMOOTHED, JOINT_SOLUTION, TARGET_DIRECTION)
_RUN_TOPICS = (*_PUBLISHED, *_RESULTS)
"""Topics read from the run's own bag only: messages in another bag are inputs of this run or results of another run."""

_INSTALLATION_PREFIXES = "star.", "reference."
"""Prefixes of the names of installation angles."""


@dataclass(frozen=True)
class AlignmentValue:
    """One estimated quantity.

    Attributes:
        name: name in the message.
        value: value in ``unit``, angles from -180 deg to 180 deg.
        sigma: standard deviation, same unit.
        unit: ``deg`` for installation angles, ``arcsec`` for other angles, else the unit in the message (``s``, ``m``,
            ``px``, ``1``).
    """

    name: str
    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class Evaluation:
    """Results of one run.

    Attributes:
        errors: errors of each source: the fused attitude first, then other attitudes, then pointings; empty if no
            truth is known.
        innovations: innovations by name of the source.
        targets: errors of directions and positions by target_id; empty if no truth is known.
        estimates: ``alignment`` or ``calibration`` → last estimates of the filters.
        invalid_counts: label of a published orientation whose truth is known → number of INVALID messages in the whole
            bag, including a skipped beginning.
        problems: problems of the bags and of their messages, one line each.
        start_ns: log time at which the bag begins.
    """

    errors: list[AttitudeErrors]
    innovations: dict[str, SourceInnovations]
    targets: dict[str, TargetErrors]
    estimates: dict[str, list[AlignmentValue]]
    invalid_counts: dict[str, int]
    problems: list[str]
    start_ns: int

    def quantities(self) -> dict[str, float]:
        """Return name → value of each quantity, with the names used in bounds (bags/README.md)."""
        values: dict[str, float] = {}
        for errors in self.errors:
            values |= {f"{errors.label}.{name}": value for name, value in errors.statistics().items()}
        values |= {f"{label}.invalid": float(count) for label, count in self.invalid_counts.items()}
        for target_id, of_target in self.targets.items():
            values |= {f"target.{target_id}.{name}": value for name, value in of_target.statistics().items()}
        for source, innovations in self.innovations.items():
            values |= {f"innovation.{source}.{name}": value for name, value in innovations.statistics().items()}
        for kind, items in self.estimates.items():
            values |= {f"{kind}.{item.name}_{item.unit}": item.value for item in items}
            values |= {f"{kind}.{item.name}_sigma_{item.unit}": item.sigma for item in items}
        return values

    def json_text(self) -> str:
        """Return all quantities as JSON; null where a value is undefined."""
        return json_text(self.quantities())


class MalformedMessages:
    """Malformed messages excluded from an evaluation, by topic."""

    def __init__(self) -> None:
        self._texts: dict[str, list[str]] = {}

    def try_add(self, topic: str, add: Callable[[Any], None], message: Any) -> None:
        """Add a message to the collector of its topic, or record the message as malformed."""
        try:
            add(message)
        except MessageRejected as refused:
            self._texts.setdefault(topic, []).append(str(refused))

    def lines(self) -> list[str]:
        """Return one line for each topic: number of excluded messages, and the reason for the first exclusion."""
        return [
            f"topic '{topic}': messages excluded: {len(texts)}, the first because {texts[0]}"
            for topic, texts in self._texts.items()
        ]


def evaluate(bag_path: Path, against: Path | None = None, skip_s: float = 0.0, namespace: str = "") -> Evaluation:
    """Evaluate the outputs in a bag.

    Args:
        bag_path: bag with ``ship/attitude``, ``theodolite/pointing`` and other outputs.
        against: bag with the truth and the inputs, if they are not in ``bag_path``.
        skip_s: duration at the beginning of the bag whose errors and accepted innovations are excluded; the counts of
            INVALID and rejected messages still cover the whole bag.
        namespace: namespace of the ship in the bags; bags written by a replay may have none.

    Raises:
        BadInput: a bag or its suite file cannot be read, ``bag_path`` contains nothing to evaluate, or ``skip_s`` is
            negative or exceeds the length of this bag.
    """
    with read_bag(bag_path) as bag:
        others = [] if against is None or against.resolve() == bag_path.resolve() else [read_bag(against)]
        try:
            return _evaluate(bag, others, skip_s, namespace)
        finally:
            for other in others:
                other.close()


def _evaluate(bag: Bag, others: list[Bag], skip_s: float, namespace: str) -> Evaluation:
    bags = [*others, bag]
    named = {other: relative_topics(other.topics, namespace) for other in others}
    named[bag] = relative_topics(bag.topics, namespace_of_outputs(bag.topics, namespace, _RUN_TOPICS))
    length_s = (bag.end_ns - bag.start_ns) / NS_PER_S
    if not 0.0 <= skip_s <= length_s:
        text = f"{skip_s:g} s to skip: expected from 0 to {length_s:.1f} s, the length of the bag"
        raise BadInput(text, file=bag.path, value=skip_s)
    ship = _config(bags, ShipAttitudeConfig, "ship_attitude")
    star = _config(bags, StarAttitudeConfig, "star_attitude")
    theodolite = _config(bags, OpticalAxisConfig, "optical_axis")
    collectors = attitude_sources(_truths(named), ship, star, theodolite)
    malformed = MalformedMessages()
    targets = _true_targets(named, malformed)
    innovations = InnovationCollector()
    last: dict[str, BagRecord] = {}
    for candidate, topics in _reading_plan(named, bag, [*collectors, *_RESULTS, TARGET_DIRECTION]):
        for record in with_bag_progress(candidate.records(topics), candidate, "evaluating"):
            topic = topics[record.topic]
            if topic in _INNOVATION_TOPICS:
                innovations.add(record.decode())
            elif topic == TARGET_DIRECTION:
                malformed.try_add(topic, targets.add_message, record.decode())
            elif topic in _ESTIMATES:
                last[_ESTIMATES[topic]] = record
            else:
                malformed.try_add(topic, collectors[topic].add_message, record.decode())
    start_ns = bag.start_ns
    skip_to_ns = start_ns + round(skip_s * NS_PER_S)
    found = [errors for source in collectors.values() for errors in source.errors()]
    errors = [kept for errors in found if len((kept := errors.since(skip_to_ns)).time_ns)]
    problems = [problem for candidate in bags for problem in candidate.problems]
    problems += [*malformed.lines(), *_missing_source_lines(collectors, errors)]
    if not errors and not innovations.sources and not last:
        raise BadInput(
            "nothing to evaluate: expected topics "
            + ", ".join(f"{known.topic} (with {known.truth_topic})" for known in ORIENTATIONS)
            + f", {' or '.join(_RESULTS)}, found {', '.join(sorted(bag.topics)) or 'none'}",
            file=bag.path,
        )
    published = [source for source in collectors.values() if isinstance(source, PublishedAttitude)]
    return Evaluation(
        errors=errors,
        innovations={name: innovations.sources[name].since(skip_to_ns) for name in sorted(innovations.sources)},
        targets=targets.since(skip_to_ns),
        estimates={kind: alignment_values(last[kind].decode()) for kind in _ESTIMATES.values() if kind in last},
        invalid_counts={source.label: source.invalid_count for source in published if source.has_messages},
        problems=problems,
        start_ns=start_ns,
    )


def _missing_source_lines(collectors: Mapping[str, AttitudeSource], errors: list[AttitudeErrors]) -> list[str]:
    """Return one line for each configured sensor that has no errors."""
    shown = {series.label for series in errors}
    return [
        f"{source.label} not evaluated: no attitude on {topic} while the truth is known"
        for topic, source in collectors.items()
        if source.is_configured and source.label not in shown
    ]


_TopicNames = Mapping[Bag, Mapping[str, str]]
"""Bag → relative topic → name of the topic in the bag; the run's own bag is the last."""


def _reading_plan(named: _TopicNames, own: Bag, topics: list[str]) -> list[tuple[Bag, dict[str, str]]]:
    """Return the topics to read from each bag: name in the bag → relative name.

    Results are read from the run's own bag, inputs from the bag given by ``against`` if it contains them. A sensor's
    solutions may be results or inputs: solutions in the run's own bag take precedence.
    """
    plan: list[tuple[Bag, dict[str, str]]] = [(candidate, {}) for candidate in named]
    for topic in topics:
        for candidate, served in reversed(plan) if topic.endswith("/solution") else plan:
            name = named[candidate].get(topic)
            if name is not None and (candidate is own or topic not in _RUN_TOPICS):
                served[name] = topic
                break
    return plan


def _truths(named: _TopicNames) -> dict[str, Truth]:
    """Return topic of the truth → truth, read from the first bag that contains messages of this topic."""
    truths: dict[str, Truth] = {}
    for bag, names in named.items():
        wanted = {
            names[known.truth_topic]: Truth(known)
            for known in ORIENTATIONS
            if known.truth_topic in names and known.truth_topic not in truths
        }
        for record in bag.records(wanted) if wanted else ():
            wanted[record.topic].add(record.decode())
        truths |= {truth.orientation.truth_topic: truth for truth in wanted.values() if len(truth)}
    return truths


def _true_targets(named: _TopicNames, malformed: MalformedMessages) -> TargetDirections:
    """Return the targets with their truth, read from the first bag that contains true targets."""
    targets = TargetDirections()
    for bag, names in named.items():
        if TARGET_TRUTH in names and not len(targets):
            for record in bag.records({names[TARGET_TRUTH]}):
                malformed.try_add(TARGET_TRUTH, targets.add_truth, record.decode())
    return targets


def _config(bags: list[Bag], kind: type[Config], node_name: str) -> Config | None:
    """Return a node's configuration from a suite file attached to a bag; the run's own bag takes precedence.

    The result is None if no bag has a suite file, or if the file has no section for the node.
    """
    for bag in reversed(bags):
        if SUITE_ATTACHMENT in bag.attachments:
            text = bag.attachments[SUITE_ATTACHMENT].decode("utf-8", errors="replace")
            try:
                return named_config(text, kind, node_name)
            except BadInput as problem:
                raise attachment_error(bag, problem) from problem
    return None


def named_config(text: str, kind: type[Config], node_name: str) -> Config | None:
    """Return a node's configuration from a suite file, in any namespace; None if no section is for the node.

    Raises:
        BadInput: the text is not a parameter file, or a parameter is unknown, missing or wrong.
    """
    # A section for all nodes counts for ship_attitude only, as in a replay (adapter_chain.nodes_of).
    node = in_any_namespace(node_name)
    named = has_section(text, node, wildcards=kind is ShipAttitudeConfig)
    return load_config(kind, text, node) if named else None


def alignment_values(message: Any) -> list[AlignmentValue]:
    """Return the values of an AlignmentState or a TheodoliteCalibration."""
    count = len(message.names)
    sigmas = np.sqrt(np.diagonal(np.asarray(message.covariance).reshape(count, count)))
    values = []
    for name, value, sigma, unit in zip(message.names, message.values, sigmas, message.units, strict=True):
        scale, shown_unit = 1.0, unit
        if unit == "rad":
            value = float(wrap_pi(value))
            is_installation = name.startswith(_INSTALLATION_PREFIXES)
            scale, shown_unit = (np.pi / 180.0, "deg") if is_installation else (ARCSEC, "arcsec")
        values.append(AlignmentValue(name, float(value) / scale, float(sigma) / scale, shown_unit))
    return values
