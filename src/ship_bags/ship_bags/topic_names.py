"""Names of topics: the suite's relative names, and the ship's own names from ``--remap`` and from a suite file.

A suite's relative name is the name of a bag's topic without the namespace of the ship.

The map ``topics`` of a suite file gives the ship's name for the suite's name of a topic, as
``topics: {ins/imu: /imu/data}``; ``--remap OLD:=NEW`` does the same for one command. The names apply to all bags that
the process of a command reads (:func:`ship_bags.command_line.run_command`). Only the bag reader applies the names, so
that no other code depends on them.
"""

import argparse
import contextlib
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ship_geometry.input_error import InputError

TRUTH_PREFIX = "truth/"
"""Prefix of topics of simulated bags with the truth, which an estimator must not use."""


TOPICS_PARAMETER = "topics"
"""Group of parameters, the same in each node: the suite's name of an input → the ship's name."""

BLACK_BOX_METADATA = "black_box"
"""Name of the metadata record of a node's black box, in which topics have the suite's names."""

_MOST_ADVISED = 3
_PREFIX = f"{TOPICS_PARAMETER}."
_NAME = r"[A-Za-z_][A-Za-z0-9_]*"
_SUITE_NAME = re.compile(rf"{_NAME}(/{_NAME})+", re.ASCII)
_SHIP_NAME = re.compile(rf"/?{_NAME}(/{_NAME})*", re.ASCII)


def relative_topic(name: str, namespace: str = "") -> str | None:
    """Return the suite's relative name of a bag's topic; None for a topic outside the namespace.

    Args:
        name: name of the topic in the bag, e.g. ``/ship/ins/imu``, ``/ins/imu`` or ``ins/imu``.
        namespace: namespace of the ship in the bag, with or without slashes; empty if the bag has no namespace.
    """
    bare, prefix = name.lstrip("/"), namespace.strip("/")
    if not prefix:
        return bare
    return bare.removeprefix(prefix + "/") if bare.startswith(prefix + "/") else None


def resolve_topic(name: str, namespace: str) -> str:
    """Return the full name of a topic as ROS resolves it: a name without leading slash is in the namespace."""
    return name if name.startswith("/") else "/".join(["", *filter(None, namespace.split("/")), name])


def relative_topics(names: Iterable[str], namespace: str = "") -> dict[str, str]:
    """Return relative name → name in the bag, for all topics inside the namespace."""
    pairs = ((relative_topic(name, namespace), name) for name in names)
    return {relative: name for relative, name in pairs if relative is not None}


def namespace_of_outputs(names: Iterable[str], namespace: str, outputs: Iterable[str]) -> str:
    """Return the namespace of the outputs in a bag: the ship's, or an empty one as in a bag written by a replay.

    Args:
        names: names of the bag's topics.
        namespace: namespace of the ship.
        outputs: relative names of outputs; if one of these outputs is in the ship's namespace, this namespace is
            returned.
    """
    found = relative_topics(names, namespace)
    return namespace if any(topic in found for topic in outputs) else ""


def likely_namespace(names: Iterable[str], wanted: Iterable[str]) -> str | None:
    """Return the namespace with all wanted relative names in the bag; None unless there is exactly one."""
    bare, needed = {name.lstrip("/") for name in names}, set(wanted)
    if not needed:
        return None
    first = min(needed)
    prefixes = [name.removesuffix("/" + first) for name in bare if name.endswith("/" + first)]
    fitting = [prefix for prefix in prefixes if all(f"{prefix}/{name}" in bare for name in needed)]
    return fitting[0] if len(fitting) == 1 else None


@dataclass(frozen=True)
class TopicNames:
    """Names under which a command reads the topics of its bags.

    Attributes:
        remaps: pairs of the name in the bag and the new name.
        namespace: namespace of the ship in the bag, for names without leading slash.
        is_by_suite: True if the map ``topics`` of a suite file applies, too.
        suite_file: file with the map; None for the suite file attached to the bag.
    """

    remaps: tuple[tuple[str, str], ...] = ()
    namespace: str = ""
    is_by_suite: bool = False
    suite_file: Path | None = None
    _matched: set[str] = field(default_factory=set, compare=False, repr=False)

    def new_names(self, topics: Collection[str], attached_suite: str) -> dict[str, str]:
        """Return topic in a bag → its new name, for the topics that get a new name.

        Args:
            topics: topics of the bag.
            attached_suite: text of the suite file attached to the bag; empty if there is no such file.

        Raises:
            BadInput: the suite file cannot be read, or its map is wrong.
        """
        given = {new for _, new in self.remaps}
        by_suite = {old: new for old, new in self._suite_names(attached_suite).items() if new not in given}
        wanted = {self._full(old): new for old, new in (by_suite | dict(self.remaps)).items()}
        in_bag = {topic: wanted.get(f"/{relative_topic(topic)}") for topic in topics}
        return {topic: self._full(new) if self.namespace else new for topic, new in in_bag.items() if new is not None}

    def unmatched_remaps(self, topics: Collection[str]) -> list[str]:
        """Record the topics of a bag; return the old names of the remaps that have matched no bag so far.

        A remap matches a bag that has a topic with the old or the new name.
        """
        there = {f"/{relative_topic(topic)}" for topic in topics}
        self._matched.update(old for old, new in self.remaps if {self._full(old), self._full(new)} & there)
        return [old for old, _ in self.remaps if old not in self._matched]

    def _suite_names(self, attached_suite: str) -> dict[str, str]:
        """Return name in the bag → name in the suite."""
        if not self.is_by_suite:
            return {}
        return self._file_names if self.suite_file is not None else _attached_names(attached_suite)

    @cached_property
    def _file_names(self) -> dict[str, str]:
        return {} if self.suite_file is None else names_on_ship(self.suite_file)

    def _full(self, name: str) -> str:
        return resolve_topic(name, self.namespace)


_names = TopicNames()


def current_names() -> TopicNames:
    """Return the names that apply now."""
    return _names


def use_names(names: TopicNames) -> None:
    """Apply names from now on, for all threads of the process."""
    global _names  # noqa: PLW0603 - bags are read deep inside the commands, and in their threads
    _names = names


@contextlib.contextmanager
def topic_names(names: TopicNames) -> Iterator[None]:
    """Apply names to all bags that are read in this context."""
    before = current_names()
    use_names(names)
    try:
        yield
    finally:
        use_names(before)


def add_remap_option(parser: argparse.ArgumentParser, is_by_suite: bool = False) -> None:
    """Add the option ``--remap``.

    Args:
        parser: parser of a command that reads bags.
        is_by_suite: True if the command uses topics by their names in the suite.
    """
    parser.add_argument(
        "--remap",
        nargs="+",
        action="extend",
        type=_remap,
        default=[],
        metavar="OLD:=NEW",
        help="read topic OLD of a bag as NEW, e.g. /imu/data:=ins/imu; may be given several times",
    )
    parser.set_defaults(is_by_suite=is_by_suite)


def add_bag_name_options(parser: argparse.ArgumentParser, of_what: str = "of the ship's topics in the bag") -> None:
    """Add the options ``--namespace`` and ``--remap``, by which a command finds the suite's topics in bags."""
    parser.add_argument("--namespace", default="", help=f"namespace {of_what}")
    add_remap_option(parser, is_by_suite=True)


def names_from_options(options: argparse.Namespace) -> TopicNames:
    """Return the topic names that the options of a command give."""
    suite_file = getattr(options, "config", None)
    return TopicNames(
        tuple(getattr(options, "remap", ())),
        getattr(options, "namespace", ""),
        getattr(options, "is_by_suite", False),
        suite_file if isinstance(suite_file, Path) else None,
    )


def remap_advice(
    wanted: str, type_name: str, topics: Mapping[str, str], known: Collection[str], namespace: str = ""
) -> str:
    """Return the options that map topics of the right type to a missing input, as ``type on /x: --remap /x:=wanted``.

    The text has three topics at most, and is empty without a candidate. Truth topics are not candidates.

    Args:
        wanted: the suite's name of the input.
        type_name: type of the input.
        topics: topic of the bag → type.
        known: the suite's names of all topics of the suite; these topics are not candidates.
        namespace: namespace of the ship in the bag.
    """
    of_type = {topic: relative_topic(topic, namespace) or "" for topic, kind in topics.items() if kind == type_name}
    free = sorted(topic for topic, name in of_type.items() if name not in known and not name.startswith(TRUTH_PREFIX))
    names = free[:_MOST_ADVISED]
    options = " or ".join(f"--remap {name}:={wanted}" for name in names)
    return f"{type_name.replace('/msg/', '/')} on {', '.join(names)}: {options}" if names else ""


def topic_map(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Return the suite's name of an input → the ship's name, from a node's parameters by dotted names.

    Raises:
        InputError: a parameter is wrong; the text names the parameter and what is expected.
    """
    entries = {name: value for name, value in parameters.items() if is_topic_parameter(name)}
    for name, value in entries.items():
        if not _SUITE_NAME.fullmatch(name.removeprefix(_PREFIX)):
            reason = f"parameter '{name}': expected the suite's name of an input behind '{_PREFIX}', as ins/imu"
            raise InputError(reason, parameters=(name,))
        if not (isinstance(value, str) and _SHIP_NAME.fullmatch(value)):
            reason = f"parameter '{name}' = {value!r}: expected the name of a topic, as /imu/data"
            raise InputError(reason, parameters=(name,), value=value)
    if TOPICS_PARAMETER in parameters:
        reason = f"parameter '{TOPICS_PARAMETER}': expected a group of names, as {{ins/imu: /imu/data}}"
        raise InputError(reason, parameters=(TOPICS_PARAMETER,))
    return {name.removeprefix(_PREFIX): value for name, value in entries.items()}


def is_topic_parameter(name: str) -> bool:
    """True if a dotted name is an entry of the map ``topics``."""
    return name.startswith(_PREFIX)


def ship_names(source: Path | str) -> dict[str, str]:
    """Return the suite's name of an input → the ship's, of all sections of a suite file; see :func:`names_on_ship`."""
    return {suite_name: ship_name for ship_name, suite_name in names_on_ship(source).items()}


def names_on_ship(source: Path | str) -> dict[str, str]:
    """Return the ship's name of a topic → the suite's name, from all sections of a suite file (its path or its text).

    Raises:
        BadInput: the file cannot be read; an entry is wrong; or two entries contradict each other, although all nodes
            read the same bag.
    """
    from ship_bags.parameter_yaml import merge_sections, read_sections  # needed for few commands

    name, sections = read_sections(source)
    found: dict[str, str] = {}
    for section in sections:
        file = merge_sections(name, [section])
        try:
            entries = topic_map({key: value for key, (value, _) in section.parameters.items()})
            for suite_name, ship_name in entries.items():
                known = {suite: ship for ship, suite in found.items()}.get(suite_name, ship_name)
                parameter = f"{_PREFIX}{suite_name}"
                if known != ship_name:
                    reason = f"parameter '{parameter}' = '{ship_name}': it is '{known}' in another section"
                    raise InputError(f"{reason}, and a bag has one topic for all nodes", parameters=(parameter,))
                if found.setdefault(ship_name, suite_name) != suite_name:
                    reason = f"parameter '{parameter}' = '{ship_name}': that is {found[ship_name]} already"
                    raise InputError(f"{reason}, and a topic of a bag has one name", parameters=(parameter,))
        except InputError as problem:
            raise file.error(problem) from problem
    return found


def _attached_names(text: str) -> dict[str, str]:
    """Return the map of an attached file; empty if the file is unusable. A command that needs the file reports this."""
    if TOPICS_PARAMETER not in text:
        return {}
    try:
        return names_on_ship(text)
    except InputError:
        return {}


def _remap(text: str) -> tuple[str, str]:
    old, separator, new = text.partition(":=")
    if not (separator and _SHIP_NAME.fullmatch(old) and _SHIP_NAME.fullmatch(new)):
        raise argparse.ArgumentTypeError(f"'{text}' is not of the form OLD:=NEW, as /imu/data:=ins/imu")
    return old, new
