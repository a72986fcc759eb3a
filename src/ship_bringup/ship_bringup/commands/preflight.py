"""``preflight``: all checks that are possible before the voyage, in one table, and an exit code."""

import argparse
import datetime
import os
import shlex
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ship_bags.command_line import CommandParser, launcher, run_command
from ship_bags.errors import BadInput
from ship_bags.live.ros_process import (
    dds_has_security,
    is_security_requested,
    loaded_libraries,
    namespace_name,
    positive_number,
)
from ship_bags.parameter_yaml import full_name
from ship_bags.topic_names import ship_names
from ship_bringup.checks.check_line import CheckLine, Result, exit_code, summary_text, table, worst_first
from ship_bringup.checks.clock_check import check_clock, read_clock_state
from ship_bringup.checks.disk_check import check_disk, estimate_write_rates, read_disk_state
from ship_bringup.checks.network_check import (
    check_domain,
    check_keystore,
    check_security,
    check_sensors,
    check_settings,
    find_requested_qos,
)
from ship_bringup.checks.network_state import NetworkState, observe_network
from ship_bringup.checks.resource_check import check_files, check_places, read_path_states, read_place_states
from ship_bringup.security.demand import KEYSTORE, domain_of
from ship_bringup.security.keystore import KeystoreUse
from ship_bringup.security.rights import load_companions, nmea_in_topics, suite_rights
from ship_bringup.suite.plan import missing_saved_files
from ship_replay.offline.adapter_chain import AdapterChain
from ship_replay.offline.replay import ADAPTERS
from ship_replay.preflight.check_bag import load_text, load_warnings, measured_slowness, node_loads
from ship_replay.preflight.check_config import CheckedNode, Findings, check_file
from ship_watch.safety.limits import Limits, read_limits

_DESCRIPTION = """\
Checks before the voyage that a suite can run here: its file, DDS security with the ship's keystore and policies, the
clock (chrony or PTP; its offset in ms, and in arcseconds during a turn of 5 deg/s), the domain and the nodes in it, the
disk space for the voyage's record and black boxes, files and permissions, the ports and devices of nmea_in and
nmea_out, data of every sensor in the file, and the load of this computer at the sensors' rates. All checks are made,
also after a failure; nothing is changed on the machine. Start the drivers first, then preflight, then the suite.
"""
_EPILOG = "exit code: 0 no check failed, perhaps warnings; 1 a check failed; 2 bad input or usage"
_HOURS, _DAYS, _LISTEN_S = 12.0, 30.0, 5.0
_LOAD = "load"


@dataclass(frozen=True)
class _Suite:
    """Data of all checks: the command line, the ship's limits, and the nodes that the file defines."""

    options: argparse.Namespace
    limits: Limits
    nodes: Sequence[CheckedNode]
    findings: Findings
    chain: AdapterChain

    @property
    def companions(self) -> dict[str, Any]:
        try:
            return load_companions(self.options.file, self.options.namespace)
        except BadInput:
            return {}  # the error is reported with the parameters

    def full_names(self, nodes: Iterable[str]) -> list[str]:
        return [full_name(name, self.options.namespace) for name in nodes]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``preflight``; return the exit code."""
    return run_command(_parser(), _preflight, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_bringup",
        prog="preflight",
        example="examples/two_sensors.yaml --box /tmp --hours 12",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="suite file")
    parser.add_argument(
        "--namespace", type=namespace_name, default="", metavar="NS", help="namespace of all nodes and topics (none)"
    )
    parser.add_argument(
        "--limits", type=Path, metavar="FILE", help="the ship's limits; they also define if DDS security is required"
    )
    parser.add_argument(
        "--locked", action="store_true", help="no parameter of a running node may be set: policies must deny it"
    )
    parser.add_argument(
        "--reliable-inputs",
        action="store_true",
        help="suite will be started with this option: every driver must offer reliable",
    )
    parser.add_argument("--box", type=Path, metavar="FOLDER", help="black boxes will go into this folder")
    parser.add_argument(
        "--hours",
        type=positive_number,
        default=_HOURS,
        metavar="H",
        help=f"hours that the disk space must last ({_HOURS:g})",
    )
    parser.add_argument(
        "--days",
        type=positive_number,
        default=_DAYS,
        metavar="D",
        help=f"days that certificates must be valid ({_DAYS:g})",
    )
    parser.add_argument(
        "--listen",
        type=positive_number,
        default=_LISTEN_S,
        metavar="S",
        help=f"receive each sensor for S s ({_LISTEN_S:g})",
    )
    return parser


def _preflight(options: argparse.Namespace) -> int:
    limits = Limits() if options.limits is None else read_limits(options.limits)
    findings = Findings()
    nodes = check_file(options.file, ADAPTERS, findings, options.namespace)
    suite = _Suite(options, limits, nodes, findings, AdapterChain([node.adapter for node in nodes]))
    # Security is checked before a node is created: creation would fail if security is demanded but not available.
    security = list(_security(suite))
    settings = list(check_settings(os.environ))
    network = _network(suite, settings)
    own = suite.full_names(adapter.node_name for adapter in suite.chain.adapters)
    domain = [*settings, *check_domain(network, own, suite.full_names(suite.companions))]
    files = check_files(read_path_states(options.file, options.box), list(missing_saved_files(options.file, nodes)))
    place_states = list(read_place_states(options.file, options.namespace, suite.companions))
    checks = [_parameters(suite), security, [check_clock(read_clock_state(), limits)], domain, _disk(suite, network)]
    checks += [files, check_places(place_states, network.nodes), _sensors(suite, network), _load(suite, network)]
    lines = worst_first(checks)
    print("\n".join(table(lines)))
    print(f"{options.file}: {summary_text(lines)}")
    return exit_code(lines)


def _parameters(suite: _Suite) -> Iterable[CheckLine]:
    for text in suite.findings.errors:
        yield CheckLine("parameters", Result.FAIL, text, f"for details: {launcher()} ship_replay check_config")
    for text in suite.findings.warnings:
        yield CheckLine("parameters", Result.WARN, text)
    if not suite.findings.errors:
        names = ", ".join([*(adapter.node_name for adapter in suite.chain.adapters), *suite.companions])
        yield CheckLine("parameters", Result.OK, f"{suite.options.file}: good for {names}")


def _security(suite: _Suite) -> Iterable[CheckLine]:
    required, keystore = suite.limits.machine.require_security, os.environ.get(KEYSTORE, "")
    yield from check_security(os.environ, dds_has_security(loaded_libraries()), required)
    is_demand = required or is_security_requested(os.environ)
    if keystore or is_demand:
        namespace, names = suite.options.namespace, ship_names(suite.options.file)
        use = KeystoreUse(
            rights=suite_rights(
                suite.chain.adapters, namespace, suite.options.locked, companions=suite.companions, ship_names=names
            ),
            domain_id=domain_of(os.environ),
            now=datetime.datetime.now(datetime.timezone.utc),
            voyage=datetime.timedelta(days=suite.options.days),
            authority_sha256=suite.limits.machine.authority_sha256,
        )
        yield from check_keystore(keystore, use, is_demand)


def _network(suite: _Suite, settings: Sequence[CheckLine]) -> NetworkState:
    """Return the state of the network; with a wrong setting nothing is read, because DDS would end this process."""
    for line in settings:
        if line.result is Result.FAIL:
            return NetworkState(failure=line.finding)
    if sys.stderr.isatty():
        print(f"preflight: receives each sensor for {suite.options.listen:g} s", file=sys.stderr)
    # Global topics, for example /diagnostics, may be published by nodes outside the suite.
    given = [topic.topic for topic in suite.chain.outputs if not topic.topic.startswith("/")]
    options = suite.options
    return observe_network(suite.chain.inputs, given, options.namespace, options.listen, ship_names(options.file))


def _disk(suite: _Suite, network: NetworkState) -> Iterable[CheckLine]:
    write_rates, box = estimate_write_rates(suite.chain.adapters, network.inputs), suite.options.box
    disk_path = suite.limits.machine.disk_path
    must_be_there = "machine.disk_path" if disk_path else ""
    states = [(read_disk_state(Path(disk_path) if disk_path else box or Path.cwd()), write_rates.record, must_be_there)]
    if box is not None:
        states.append((read_disk_state(box), write_rates.boxes, ""))
    for state, _, named_by in states:
        # The needs of all folders on one disk are added.
        needs = sum(bytes_per_s for other, bytes_per_s, _ in states if other.device == state.device)
        yield from check_disk(state, needs, suite.options.hours, suite.limits, named_by)


def _sensors(suite: _Suite, network: NetworkState) -> Iterable[CheckLine]:
    options, lags_s = suite.options, dict[str, float]()
    for node in suite.nodes:
        for topic in node.adapter.inputs:
            lag_s = float(getattr(node.config, "lag_s", 2.0))
            lags_s[topic.topic] = min(lag_s, lags_s.get(topic.topic, lag_s))
    requested_qos = find_requested_qos(options.file, lags_s, options.namespace, options.reliable_inputs)
    yield from check_sensors(
        network, suite.limits, lags_s, requested_qos, nmea_in_topics(suite.companions), _nmea_in(suite)
    )


def _load(suite: _Suite, network: NetworkState) -> Iterable[CheckLine]:
    """Check the load at the received rates; yield no line if no input has a rate."""
    rates_hz = {observed.input.topic: observed.rate_hz for observed in network.inputs if observed.rate_hz > 0.0}
    if not rates_hz:
        return
    found = node_loads(suite.chain.adapters, rates_hz, measured_slowness())
    for text in load_warnings(found, len(os.sched_getaffinity(0))):
        yield CheckLine(_LOAD, Result.WARN, text, "lower the rates, or use a faster computer")
    yield CheckLine(_LOAD, Result.OK, load_text(found).removeprefix(f"{_LOAD}: "))


def _nmea_in(suite: _Suite) -> str:
    """Return the command that starts the suite's ``nmea_in`` alone."""
    names = suite.options.namespace and f" -r __ns:=/{suite.options.namespace}"
    return f"{launcher()} ship_nmea nmea_in --ros-args{names} --params-file {shlex.quote(str(suite.options.file))}"


if __name__ == "__main__":
    raise SystemExit(main())
