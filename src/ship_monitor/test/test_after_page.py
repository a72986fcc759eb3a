"""Page of a bag in a headless Chromium: slider, buttons and keys set the displayed time."""

import pytest

from ship_monitor.page.bag_playback import BagPlayback, RecordedSuite
from ship_testing import browser as browser_module
from ship_testing.browser import Browser
from ship_testing.hand_made_bags import write_imu_bag
from ship_testing.page_runs import run_page_server
from ship_testing.recorded_suites import write_suite
from ship_watch.safety.limits import Limits

pytestmark = pytest.mark.skipif(browser_module.CHROMIUM is None, reason="there is no Chromium on this machine")

# The bags begin at 22:13:20.05 (START_NS).
AT_END, AT_START = "22:28:20", "22:13:20"
UTC = "document.querySelector('#utc').textContent"
SLIDER = "Bokeh.documents[0].get_model_by_name('time')"
INSIDE_CONTROLS = """(() => {
  const texts = [], look = (root) => root.querySelectorAll('*').forEach((each) => {
    texts.push(each.textContent);
    if (each.shadowRoot) look(each.shadowRoot);
  });
  look(document.querySelector('#controls'));
  return texts.join(' ');
})()"""
PLAY = "Bokeh.documents[0].get_model_by_name('play')"


@pytest.fixture(scope="module")
def browser():
    browser = Browser()
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_suite(tmp_path_factory.mktemp("after") / "night.mcap")


def page_of(path):
    return run_page_server(BagPlayback(RecordedSuite(path), Limits()))


def press(browser, key, *, shift=False):
    event = f"new KeyboardEvent('keydown', {{key: '{key}', shiftKey: {str(shift).lower()}}})"
    browser.evaluate(f"document.dispatchEvent({event})")


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["day", "night"])
@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
def test_slider_is_under_the_bar_in_the_colours_of_the_page(browser, bag, theme, size, tmp_path):
    with page_of(bag) as server:
        browser.open(f"{server.address}?theme={theme}", *size)
        browser.wait_until_true(f"{UTC} === '{AT_END}'")
        browser.wait_until_true("document.querySelector('#controls').offsetHeight > 30")
        browser.take_screenshot(tmp_path / "page.png")
        assert browser.problems == []
        assert browser.text("#label") == "BAG"
        assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth"), "wider than the window"
        place = "document.querySelector('#{}').getBoundingClientRect().{}"
        track = f"Bokeh.index.find_one({SLIDER}).el.getBoundingClientRect().width"
        assert browser.wait_until_true(track) > size[0] / 3
        assert browser.evaluate(place.format("controls", "top")) >= browser.evaluate(place.format("bar", "bottom"))
        assert browser.evaluate(place.format("controls", "bottom")) <= browser.evaluate(place.format("heading", "top"))
        if size == (1280, 800):  # data that are missing in the bag are named next to the slider
            assert "contains no truth" in browser.evaluate(INSIDE_CONTROLS)
            assert browser.evaluate(place.format("ribbons", "bottom")) <= 800
            assert browser.evaluate("[heading, ages, sources].every((each) => each.scrollHeight <= each.clientHeight)")


@pytest.mark.slow
def test_keys_move_the_time_and_play(browser, bag):
    with page_of(bag) as server:
        browser.open(server.address)
        # The first texts are in the page itself; keys work after its models are loaded.
        browser.wait_until_true(f"window.Bokeh && Bokeh.documents.length && {UTC} === '{AT_END}'")
        assert "OUT" in browser.text("#sources")
        press(browser, "ArrowLeft")
        browser.wait_until_true(f"{UTC} === '22:28:10'")
        press(browser, "ArrowLeft", shift=True)
        browser.wait_until_true(f"{UTC} === '22:27:10'")
        press(browser, "Home")
        browser.wait_until_true(f"{UTC} === '{AT_START}'")
        assert "OUT" not in browser.text("#outs")
        press(browser, " ")
        browser.wait_until_true(f"{PLAY}.active && {UTC} >= '22:13:22' && {SLIDER}.value >= 1")
        press(browser, " ")
        browser.wait_until_true(f"!{PLAY}.active")
        press(browser, "End")
        browser.wait_until_true(f"{UTC} === '{AT_END}'")
        assert browser.problems == []


def test_bag_without_outputs_is_reported_in_one_line(browser, tmp_path):
    with page_of(write_imu_bag(tmp_path / "inputs.mcap")) as server:
        browser.open(server.address)
        browser.wait_until_true("document.querySelector('#alert-sub').textContent.includes('only inputs')")
        assert browser.problems == []
