"""What the documentation says is what the code does."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tools"))

import parameter_table  # noqa: E402  the tool is a script beside the tests, not an installed package


def test_parameter_page_is_current() -> None:
    assert parameter_table.PAGE.read_text(encoding="utf-8") == parameter_table.page(), "run tools/parameter_table.py"
