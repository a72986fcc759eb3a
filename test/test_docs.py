"""What the documentation says is what the code does."""

from pathlib import Path

from tools import parameter_table

ROOT = Path(__file__).parents[1]


def test_parameter_page_is_current() -> None:
    assert parameter_table.PAGE.read_text(encoding="utf-8") == parameter_table.page(), "run tools/parameter_table.py"
