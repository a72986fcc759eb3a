"""Reports of tools/audit.py and tools/licences.py: wheels without a result are listed, and all licences are known.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.licences import PAGE, STATED_ELSEWHERE, distributions, incompatible_licences, is_compatible, licence, page

ROOT = Path(__file__).parents[1]
over_ros = pytest.mark.skipif((ROOT / ".venv" / ".ros_prefix").exists(), reason="the wheels of ROS are not installed")


@over_ros
@pytest.mark.skipif(sys.version_info < (3, 11), reason="other pins have other metadata")
def test_the_page_of_licences_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run tools/licences.py"


@over_ros
def test_every_wheel_may_be_distributed_with_the_suite() -> None:
    assert incompatible_licences() == []
    assert STATED_ELSEWHERE.keys() <= set(distributions())


@pytest.mark.parametrize(
    ("expression", "may"),
    [
        ("MIT", True),
        ("Apache-2.0 OR GPL-3.0-only", True),
        ("MIT AND GPL-3.0-only", False),
        ("GPL-3.0-only OR AGPL-3.0-only", False),
        ("LGPL-2.1-or-later", True),
        ("", False),
        ("nan", False),
    ],
)
def test_of_licences_that_may_be_chosen_one_must_fit(expression: str, may: bool) -> None:
    assert is_compatible(expression) is may


def test_a_missing_wheel_has_no_licence() -> None:
    assert licence("no-such-wheel") == ("", "not installed")


def evaluate_report(report: str) -> str:
    """Return the result of tools/audit.py for a report about pins of two wheels."""
    code = f"import audit; print(audit.evaluate_report({report}, ['a==1', 'b==2']))"
    answer = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT / "tools", capture_output=True, text=True, check=True, env={**os.environ}
    )
    return answer.stdout.strip()


def test_a_vulnerability_is_listed_with_its_fix_and_a_missing_result_is_listed() -> None:
    """The report has the form of pip-audit 2.10, in which the entry of a skipped wheel has no ``vulns``."""
    flaw = {"id": "PYSEC-2026-1", "fix_versions": ["3"], "aliases": [], "description": ""}
    left_out = {"name": "b", "skip_reason": "not found"}
    report = {"dependencies": [{"name": "a", "version": "1", "vulns": [flaw]}, left_out]}
    assert evaluate_report(repr(report)) == "(['a==1: PYSEC-2026-1, fixed in 3'], ['b==2'])"
    assert evaluate_report("{'dependencies': []}") == "([], ['a==1', 'b==2'])"
