"""What the documentation says is what the code does."""

from pathlib import Path

from tools import reference_pages

ROOT = Path(__file__).parents[1]


def test_parameter_page_is_current() -> None:
    assert reference_pages.PAGE.read_text(encoding="utf-8") == reference_pages.page(), "run tools/reference_pages.py"
