"""Programs of a suite: a node for each section of its file, monitoring programs, and the player of a bag.

If DDS security is demanded, each program has an identity in it: the enclave of its name.
"""

import datetime
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ship_bags.errors import BadInput
from ship_bags.live.ros_process import executable, is_security_requested
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.parameter_yaml import full_name, in_any_namespace, read_sections
from ship_bags.topic_names import (
    TRUTH_PREFIX,
    current_names,
    likely_namespace,
    relative_topics,
    resolve_topic,
    ship_names,
    topic_names,
)
from ship_bringup.security.demand import KEYSTORE, domain_of, enclave_command
from ship_bringup.security.keystore import KeystoreUse, require_keystore
from ship_bringup.security.rights import Rights, load_companions, suite_rights
from ship_bringup.suite.program import Program, Role
from ship_node.messages.common_messages import TF_STATIC_TOPIC, TF_TOPIC
from ship_node.parameters.parameter_file import COMPANIONS, Companion, configured_companions, unknown_sections
from ship_replay.offline.adapter_chain import AdapterChain
from ship_replay.offline.replay import ADAPTERS, match_inputs
from ship_replay.preflight.check_config import CheckedNode, Findings, check_file
from ship_watch.safety.limits import Limits, read_limits

SAVED_FILES = "alignment_file", "calibration_file"
"""Parameters with a file that a node reads at its start and writes periodically."""


def add_enclaves(
    programs: Sequence[Program], all_rights: Sequence[Rights], namespace: str, limits: Limits
) -> tuple[list[Program], list[str]]:
    """Return the programs, each in the enclave of its name, and warnings about the ship's keystore.

    Args:
        programs: programs of the suite.
        all_rights: rights of all programs that may belong to the suite.
        namespace: namespace of the suite.
        limits: limits of the ship, which may contain the SHA-256 of the ship's authority.

    Raises:
        BadInput: there is no keystore, or the suite cannot start with it (:func:`require_keystore`).
    """
    keystore = os.environ.get(KEYSTORE)
    if not keystore:
        raise BadInput(f"DDS security is demanded, and {KEYSTORE} is not set: not started; it names the keystore")
    enclaves = [full_name(program.name, namespace) for program in programs]
    use = KeystoreUse(
        rights=[replace(each, is_needed=True) for each in all_rights if each.enclave in enclaves],
        domain_id=domain_of(os.environ),
        now=datetime.datetime.now(datetime.timezone.utc),
        voyage=datetime.timedelta(0),
        authority_sha256=limits.machine.authority_sha256,
    )
    warnings = require_keystore(Path(keystore), use)
    secured = [
        replace(program, command=(*enclave_command(enclave), *program.command))
        for program, enclave in zip(programs, enclaves, strict=True)
    ]
    return secured, warnings


@dataclass(frozen=True)
class SuiteOptions:
    """Options of bringing up a suite; see ``suite --help``.

    Attributes:
        namespace: namespace of all nodes and topics of the suite, without outer slashes; empty for no namespace.
        bag: bag that is played into the suite; None for real sensors.
        rate: seconds of the bag per second.
        loop: number of times that the bag is played; 0 for endless repetition.
        monitor: True if page and alerts are started too.
        box: folder for a black box of each node; None for no black boxes.
        reliable_inputs: True if lost messages to the nodes' inputs are sent again.
        use_sim_time: True if the nodes follow /clock although no bag is played here.
        limits: file of the ship's limits for page and alerts; None for the defaults.
        monitor_arguments: further arguments of the page.
    """

    namespace: str = ""
    bag: Path | None = None
    rate: float = 1.0
    loop: int = 1
    monitor: bool = False
    box: Path | None = None
    reliable_inputs: bool = False
    use_sim_time: bool = False
    limits: Path | None = None
    monitor_arguments: tuple[str, ...] = ()


def make_plan(path: Path, options: SuiteOptions) -> tuple[list[Program], list[str]]:
    """Return the programs of a suite file in the order of their start, and warnings for the user.

    Raises:
        BadInput: file, bag or keystore is bad, or a program is not installed. The text contains the file, the line, the
            parameter or section, and what was expected; or the item that the bag lacks; or the program.
    """
    nodes, warnings = check_nodes(path, options.namespace)
    if options.bag is not None and not nodes:
        reason = f"{options.bag} cannot be played: the file has no section for an estimator, which would receive it"
        raise BadInput(reason, file=path)
    chain = AdapterChain([node.adapter for node in nodes])
    packages = {kind.node_name: kind.__module__.partition(".")[0] for kind in ADAPTERS}
    ros = _ros_arguments(options)
    programs = []
    for adapter in chain.adapters:
        name = adapter.node_name
        box = () if options.box is None else ("-p", f"black_box:={options.box.resolve()}/")
        inputs = ("-p", "reliable_inputs:=true") if options.reliable_inputs else ()
        arguments = ("--ros-args", "--params-file", str(path.resolve()), *ros, *box, *inputs)
        programs.append(Program(name, (*executable(packages[name], name), *arguments)))
    companions = [one for one in configured_companions(path, options.namespace) if options.bag is None or not one.feeds]
    programs += [_companion_program(one, path, ros, is_alone=not nodes) for one in companions]
    if options.monitor:
        programs += _monitor_programs(options, ros)
    if options.bag is not None:
        programs.append(_player_program(path, options.bag, chain, options))
    if is_security_requested(os.environ):
        limits = Limits() if options.limits is None else read_limits(options.limits)
        companion_configs = load_companions(path, options.namespace)
        is_played, names = options.bag is not None, ship_names(path)
        rights = suite_rights(
            chain.adapters, options.namespace, is_played=is_played, companions=companion_configs, ship_names=names
        )
        programs, enclave_warnings = add_enclaves(programs, rights, options.namespace, limits)
        warnings += enclave_warnings
    return programs, [*warnings, *missing_saved_files(path, nodes), *_playback_warnings(companions, options)]


def check_nodes(path: Path, namespace: str) -> tuple[list[CheckedNode], list[str]]:
    """Return the nodes of a suite file, and warnings about the file.

    Raises:
        BadInput: see :func:`make_plan`.
    """
    findings = Findings()
    nodes = check_file(path, ADAPTERS, findings, namespace)
    if findings.errors:
        first, *others = findings.errors
        raise BadInput(first + (f" (and {len(others)} more: see ship_replay check_config)" if others else ""))
    known = [kind.node_name for kind in (*ADAPTERS, *COMPANIONS)]
    unknown = unknown_sections(path, [full_name(name, namespace) for name in known])
    if unknown:
        lines = {section.node: section.line for section in read_sections(path)[1]}
        expected = ", ".join(f"'{in_any_namespace(name)}'" for name in known)
        reason = f"section '{unknown[0]}' fits no node of this suite: expected one of {expected} or '/**'"
        raise BadInput(reason, file=path, line=lines[unknown[0]])
    return nodes, findings.warnings


def missing_saved_files(path: Path, nodes: Sequence[CheckedNode]) -> Iterator[str]:
    """Yield a warning for each parameter of :data:`SAVED_FILES` that is empty."""
    for node in nodes:
        for name in SAVED_FILES:
            if getattr(node.config, name, None) == "":
                yield f"{path}: {node.adapter.node_name} has no {name}: its estimates are lost at a restart"


def _companion_program(companion: Companion, path: Path, ros: tuple[str, ...], is_alone: bool) -> Program:
    """Return the program of a node that is not an estimator; in a suite without estimators, its role is NODE."""
    command = executable(companion.package, companion.node_name)
    role = Role.NODE if is_alone else Role.FEEDER if companion.feeds else Role.WATCHER
    return Program(companion.node_name, (*command, "--ros-args", "--params-file", str(path.resolve()), *ros), role)


def _playback_warnings(companions: Sequence[Companion], options: SuiteOptions) -> Iterator[str]:
    """Yield a warning if a bag is played and ``nmea_out`` would send the bag's attitude to other equipment."""
    if options.bag is not None and any(companion.node_name == "nmea_out" for companion in companions):
        yield (
            f"nmea_out sends {options.bag} only as THS, with mode S (simulator): the other sentences are void and"
            " no alert is sent, unless tell_simulated is true"
        )


def _ros_arguments(options: SuiteOptions) -> tuple[str, ...]:
    """Return the ROS arguments of a node of the suite for namespace, topic names and clock."""
    has_clock = options.bag is not None or options.use_sim_time
    return (*_namespace_arguments(options), *(("-p", "use_sim_time:=true") if has_clock else ()))


def _namespace_arguments(options: SuiteOptions) -> tuple[str, ...]:
    """Return arguments that put a process into the suite's namespace.

    If a bag is played, its clock is in the namespace, because the time of the bag is valid for this suite only.
    Frames have the same names on each ship, and are therefore published in the namespace, not on the global /tf.
    """
    if not options.namespace:
        return ()
    clock = () if options.bag is None else ("-r", f"/clock:={resolve_topic('clock', options.namespace)}")
    frames = [word for topic in (TF_TOPIC, TF_STATIC_TOPIC) for word in ("-r", f"{topic}:={topic[1:]}")]
    return ("-r", f"__ns:=/{options.namespace}", *clock, *frames)


def _monitor_programs(options: SuiteOptions, ros: tuple[str, ...]) -> list[Program]:
    limits = () if options.limits is None else ("--limits", str(options.limits))
    where = ("--namespace", options.namespace) if options.namespace else ()
    page = (*executable("ship_monitor", "monitor"), *where, *limits, *options.monitor_arguments)
    alerts = (*executable("ship_monitor", "alerts"), *limits, "--ros-args", *ros)
    # The alert node is last, so that it ends first: it would raise alerts about the end of other programs.
    return [Program("monitor", page, Role.WATCHER), Program("alerts", alerts, Role.WATCHER)]


def _player_program(suite_file: Path, path: Path, chain: AdapterChain, options: SuiteOptions) -> Program:
    """Return the player of a bag; it plays the suite's external inputs and the truth under the names in the suite."""
    names = replace(current_names(), is_by_suite=True, suite_file=suite_file)
    with topic_names(names), read_bag(path) as bag:
        required = [topic.topic for topic in chain.inputs if topic.required]
        namespace = likely_namespace(bag.topics, required) or ""
        played = match_inputs(bag, chain, namespace)
        found = relative_topics(bag.topics, namespace)
    on_ship = ship_names(suite_file)
    targets = {name: on_ship.get(relative, relative) for name, relative in played.items()}
    targets |= {name: relative for relative, name in found.items() if relative.startswith(TRUTH_PREFIX)}
    recorded = {bag.recorded_names.get(name, name): target for name, target in targets.items()}
    remaps = [f"{name}:={resolve_topic(target, options.namespace)}" for name, target in recorded.items()]
    command = [*executable("ship_bags", "play"), str(path), "--rate", str(options.rate)]
    command += ["--loop", str(options.loop), "--topics", *recorded, "--remap", *remaps]
    return Program("play", (*command, "--ros-args", *_namespace_arguments(options)), Role.PLAYER)
