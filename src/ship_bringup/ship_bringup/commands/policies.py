"""``policies``: SROS2 policy, governance and permissions of a suite, from the declarations in its code."""

import argparse
import datetime
import os
from collections.abc import Sequence
from pathlib import Path

from ship_bags.command_line import EXIT_DONE, CommandParser, run_command
from ship_bags.live.ros_process import namespace_name
from ship_bags.output_files import add_force_option, check_folder, write_atomically
from ship_bags.topic_names import ship_names
from ship_bringup.security.demand import DOMAIN, LAST_DOMAIN, domain_of
from ship_bringup.security.policy_xml import governance_text, permissions_text, policy_text
from ship_bringup.security.rights import load_companions, suite_rights
from ship_bringup.suite.plan import check_nodes

_DESCRIPTION = """\
Writes the permissions of DDS security for each program of a suite, with least privilege, from the topics and services
that the code declares for this suite file: DIR/policy.xml for 'ros2 security generate_artifacts', and the same as
governance.xml and permissions/ENCLAVE/permissions.xml of OMG DDS Security, to be signed by hand without ros2. An
enclave has the name of its node; those of the sensors' drivers are NS/sensors/DEVICE. The files contain a fingerprint
of the declarations, by which 'preflight' detects policies that are older than the code.
"""
_EPILOG = "exit code: 0 written; 2 bad input or usage"
_DAYS = 365


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``policies``; return the exit code."""
    return run_command(_parser(), _policies, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_bringup",
        prog="policies",
        example="examples/two_sensors.yaml --out policies --namespace demo --locked",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="suite file")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    parser.add_argument(
        "--namespace", type=namespace_name, default="", metavar="NS", help="namespace of all nodes and topics (none)"
    )
    parser.add_argument("--locked", action="store_true", help="no parameter of a running node may be set")
    parser.add_argument(
        "--play", action="store_true", help="a bag may be played into the suite: for trials, not for a voyage"
    )
    parser.add_argument(
        "--domain", type=_domain, metavar="N", help=f"domain of the permissions ({DOMAIN}, else 0)"
    )
    parser.add_argument(
        "--valid-from", type=_date, metavar="DATE", help="permissions: first day, UTC, as 2026-05-01 (today)"
    )
    parser.add_argument(
        "--valid-days", type=_days, default=_DAYS, metavar="D", help=f"permissions: days of validity ({_DAYS})"
    )
    add_force_option(parser)
    return parser


def _policies(options: argparse.Namespace) -> int:
    nodes, _ = check_nodes(options.file, options.namespace)
    companions = load_companions(options.file, options.namespace)
    adapters = [node.adapter for node in nodes]
    names = ship_names(options.file)
    all_rights = suite_rights(adapters, options.namespace, options.locked, options.play, companions, names)
    domain_id = domain_of(os.environ) if options.domain is None else options.domain
    first = options.valid_from or datetime.datetime.now(datetime.timezone.utc)
    first = first.replace(hour=0, minute=0, second=0, microsecond=0)
    last = first + datetime.timedelta(days=options.valid_days)
    texts = {"policy.xml": policy_text(all_rights), "governance.xml": governance_text(domain_id)}
    for rights in all_rights:
        texts[f"permissions{rights.enclave}/permissions.xml"] = permissions_text(rights, domain_id, first, last)
    options.out.mkdir(parents=True, exist_ok=True)
    check_folder(options.out, texts, options.force)
    for name, text in texts.items():
        path = options.out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text)
    print(f"{options.out}: policies of {len(all_rights)} enclaves for domain {domain_id}")
    return EXIT_DONE


def _domain(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) > LAST_DOMAIN:
        raise argparse.ArgumentTypeError(f"{text} is not a domain of ROS: expected 0 to {LAST_DOMAIN}")
    return int(text)


def _date(text: str) -> datetime.datetime:
    try:
        return datetime.datetime.strptime(text, "%Y-%m-%d").replace(tzinfo=datetime.timezone.utc)
    except ValueError as problem:
        raise argparse.ArgumentTypeError(f"{text} is not a date: expected one as 2026-05-01") from problem


def _days(text: str) -> int:
    days = int(text)
    if not 0 < days <= 36500:
        raise argparse.ArgumentTypeError(f"{text} is not a number of days from 1 to 36500")
    return days


if __name__ == "__main__":
    raise SystemExit(main())
