"""Pages of the layout study and of the design study: no part is cut off, and the page is not excessively long."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from ship_studies.design.design_study_command import main as design_study
from ship_studies.layout.layout_study_command import main as layout_study
from ship_testing.browser import CHROMIUM, Browser

pytestmark = [
    pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]

EXAMPLE = Path(__file__).parents[1] / "examples" / "studies" / "layout.yaml"
STUDIES = {"layout_study": (layout_study, [str(EXAMPLE)]), "design_study": (design_study, [])}
MOST_PX = 7000


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    browser = Browser()
    yield browser
    browser.close()


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_page_fits_its_window(name: str, browser: Browser, tmp_path: Path) -> None:
    main, arguments = STUDIES[name]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    page = (tmp_path / f"{name}.html").as_uri()
    for width in (1366, 390):
        browser.open(page, width, 800)
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
    browser.open(page, 1366, 800)
    assert browser.evaluate("document.documentElement.scrollHeight") <= MOST_PX
    wide = "[...document.querySelectorAll('.table')].filter(one => one.scrollWidth > one.clientWidth).length"
    assert browser.evaluate(wide) == 0
    # The pictures of folded parts exist.
    browser.evaluate("document.querySelectorAll('details').forEach(one => one.open = true)")
    assert browser.evaluate("[...document.querySelectorAll('img')].every(one => one.clientHeight > 100)")
