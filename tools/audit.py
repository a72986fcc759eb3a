"""``make audit``: known vulnerabilities of the pinned versions; pip-audit, in its own environment, queries OSV.

Exit code 0: no vulnerability is known; 1: at least one is known, or the service returned no result for a version; 2:
pip-audit is not available, or the query failed.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path
from typing import Any

from bundle import pins

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from wheelhouse import NETWORK_SIGNS

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements.lock"
PIP_AUDIT = "pip-audit>=2.9,<3"
SERVICE = "https://api.osv.dev/v1/query"
BOTH_SIDES = ("3.10", "3.12")
"""Python versions that cover every pin, because the only condition in the lock is Python below 3.11 or not."""


def main() -> int:
    """Query the service and print the known vulnerabilities."""
    parser = CommandParser(prog="audit", description="Known vulnerabilities of the pinned versions; needs a network.")
    parser.add_argument("--service", default=SERVICE, metavar="URL", help=f"service with OSV's protocol ({SERVICE})")
    return run_command(parser, _audit, None)


def _audit(options: argparse.Namespace) -> int:
    lock = LOCK.read_text(encoding="utf-8")
    wanted = sorted({pin for python in BOTH_SIDES for pin in pins(lock, python)})
    print(f"audit: {len(wanted)} pinned versions, query to {options.service}", flush=True)
    with tempfile.TemporaryDirectory() as work:
        found, unanswered = evaluate_report(_query_pip_audit(wanted, options.service, Path(work)), wanted)
    for line in found + [f"{pin}: no result" for pin in unanswered]:
        print(f"audit: {line}", file=sys.stderr)
    print(f"audit: {len(found)} known vulnerabilities, {len(unanswered)} of {len(wanted)} versions without a result")
    print("audit: advisories about ROS and Fast DDS are not listed under wheels: check those separately")
    return EXIT_BOUND_NOT_MET if found or unanswered else EXIT_DONE


def evaluate_report(report: dict[str, Any], wanted: list[str]) -> tuple[list[str], list[str]]:
    """Return one line per vulnerability in a pip-audit report, and the pins that the report does not contain.

    A wheel that is missing in the report is not considered free of vulnerabilities.
    """
    audited = [entry for entry in report["dependencies"] if "vulns" in entry]
    answered = {f"{entry['name']}=={entry['version']}": entry["vulns"] for entry in audited}
    found = [
        f"{pin}: {flaw['id']}, fixed in {', '.join(flaw['fix_versions']) or 'no version yet'}"
        for pin, flaws in sorted(answered.items())
        for flaw in flaws
    ]
    return found, [pin for pin in wanted if pin not in answered]


def _query_pip_audit(wanted: list[str], service: str, work: Path) -> dict[str, Any]:
    """Return the report of pip-audit, which accepts one version per wheel and call: two versions need two calls."""
    python = _environment(work)
    dependencies: list[Any] = []
    rest = wanted
    while rest:
        names: dict[str, str] = {}
        for pin in rest:
            names.setdefault(pin.partition("==")[0], pin)
        dependencies += _one_report(python, [*names.values()], service, work)
        rest = [pin for pin in rest if pin not in names.values()]
    return {"dependencies": dependencies}


def _environment(work: Path) -> Path:
    """Return the Python of a new environment with pip-audit, which is not in the lock."""
    venv.create(work / "venv", with_pip=True)
    python = work / "venv" / "bin" / "python"
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-input", PIP_AUDIT]
    answer = subprocess.run(pip, env=_clean_environment(), capture_output=True, text=True, check=False)
    if answer.returncode:
        why = "no network" if any(sign in answer.stderr for sign in NETWORK_SIGNS) else _last(answer.stderr)
        raise BadInput(f"{PIP_AUDIT} is not available, vulnerabilities not checked: {why}")
    return python


def _one_report(python: Path, wanted: list[str], service: str, work: Path) -> list[Any]:
    """Return the entries of the report of pip-audit about these versions."""
    (work / "requirements.txt").write_text("\n".join(wanted) + "\n")
    report = work / "report.json"
    report.unlink(missing_ok=True)
    command = [str(python), "-m", "pip_audit", "--requirement", str(work / "requirements.txt"), "--no-deps"]
    command += ["--disable-pip", "--vulnerability-service", "osv", "--osv-url", service, "--progress-spinner", "off"]
    command += ["--format", "json", "--output", str(report)]
    answer = subprocess.run(command, env=_clean_environment(), capture_output=True, text=True, check=False)
    if not report.is_file() or not report.stat().st_size:
        raise BadInput(f"{service}: query failed, vulnerabilities not checked: {_last(answer.stderr)}")
    return list(json.loads(report.read_text())["dependencies"])


def _clean_environment() -> dict[str, str]:
    """Return the environment variables without the paths of the suite."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}


def _last(text: str) -> str:
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "no output")


if __name__ == "__main__":
    raise SystemExit(main())
