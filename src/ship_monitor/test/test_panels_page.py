"""The panels in a browser: headless Chromium, a page with panels only, advancing simulated minutes."""

import asyncio
import contextlib
import threading
import time
from dataclasses import replace
from io import BytesIO
from queue import Queue

import matplotlib.image
import numpy as np
import pytest
from bokeh.application import Application
from bokeh.application.handlers import FunctionHandler
from bokeh.server.server import Server

from ship_monitor.page.panels import Panels
from ship_monitor.themes import THEMES
from ship_testing import browser as browser_module
from ship_testing.browser import Browser
from ship_testing.monitored_histories import NOW_NS, simulated_history, simulated_state

pytestmark = pytest.mark.skipif(browser_module.CHROMIUM is None, reason="there is no Chromium on this machine")

FIND = """
const found = (type) => {
    const views = [];
    const walk = (view) => {
        if (view.model.type === type) views.push(view);
        for (const each of view.child_views ?? []) walk(each);
    };
    for (const root of Bokeh.index) walk(root);
    return views;
};
"""
"""JavaScript that returns the views of all models of a type."""


class Minutes:
    """Simulated minutes that advance by one measurement of each kind at each update."""

    def __init__(self) -> None:
        self.history, self.picture = simulated_history(), simulated_state()

    def advance(self) -> None:
        """Advance by one second."""
        second = 1_000_000_000
        self.picture = replace(self.picture, utc_ns=self.picture.utc_ns + second)
        for points in (
            *self.history.innovations.values(),
            *self.history.errors.values(),
            *self.history.budgets.values(),
        ):
            points.append(replace(points[-1], utc_ns=points[-1].utc_ns + second))


@contextlib.contextmanager
def serve_panels(theme):
    """Yield the address of a page with the panels only, and a queue that gets the panels of each opened page."""
    queue: Queue = Queue()
    minutes = Minutes()

    def fill(document):
        panels = Panels(THEMES[theme])
        document.add_root(panels.layout)
        document.config.notify_connection_status = False
        panels.update(minutes.history, minutes.picture)

        def advance():
            minutes.advance()
            panels.update(minutes.history, minutes.picture)

        document.add_periodic_callback(advance, 1000)
        queue.put(panels)

    def run():
        asyncio.set_event_loop(asyncio.new_event_loop())
        server = Server({"/": Application(FunctionHandler(fill))}, port=0, address="127.0.0.1")
        server.start()
        queue.put(server)
        server.io_loop.start()
        server.stop()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    server = queue.get(timeout=20.0)
    try:
        yield f"http://127.0.0.1:{server.port}/", queue
    finally:
        server.io_loop.add_callback(server.io_loop.stop)
        thread.join(20.0)


@pytest.fixture(scope="module")
def browser():
    browser = Browser()
    yield browser
    browser.close()


def open_page(browser, address, theme, width):
    browser.open(address, width, 1800)
    browser.evaluate(
        f"document.body.style.background = '{THEMES[theme].background}'; document.body.style.margin = 0;"
        """document.head.insertAdjacentHTML("beforeend", '<meta name="viewport" content="width=device-width">')"""
    )
    is_loaded = "typeof Bokeh !== 'undefined' && Bokeh.documents.length === 1"
    browser.wait_until_true(f"{is_loaded} && Bokeh.documents[0].is_idle")


def evaluate(browser, expression):
    return browser.evaluate(f"(() => {{ {FIND} return {expression}; }})()")


@pytest.mark.slow
@pytest.mark.parametrize("theme", list(THEMES))
@pytest.mark.parametrize("width", [1280, 390])
def test_panels_are_drawn_in_every_theme_and_width(browser, theme, width, tmp_path):
    with serve_panels(theme) as (address, _):
        open_page(browser, address, theme, width)
        browser.wait(lambda: evaluate(browser, "found('Figure').length") == 14, "all plots")
        browser.wait(lambda: has_text_at(browser, "found('Figure')[4]"), "the text of the error of pitch")
        browser.take_screenshot(tmp_path / f"{theme}_{width}.png", whole=True)
        assert browser.problems == []
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        heights = evaluate(browser, "found('Figure').map((each) => each.el.offsetHeight)")
        assert width > 700 or sorted(heights)[-4:-2] == [180, 180]  # only the map and the states are higher
        pixels = matplotlib.image.imread(BytesIO((tmp_path / f"{theme}_{width}.png").read_bytes()))[..., :3]
    assert len(np.unique(pixels.reshape(-1, 3)[::7], axis=0)) > 30, "nothing is drawn"
    if theme == "night":  # only red light: green and blue are at most a quarter of red, plus rounding
        assert np.all(pixels[..., 1:].max(axis=-1) <= 0.26 * pixels[..., 0] + 0.02)


@pytest.mark.slow
def test_new_points_are_streamed_and_the_time_goes_on(browser):
    with serve_panels("day") as (address, _):
        open_page(browser, address, "day", 1280)
        count = "Math.max(...found('Figure')[0].model.renderers.map((each) => each.data_source.get_length() ?? 0))"
        end = "found('Figure')[0].model.x_range.end"
        first = evaluate(browser, f"[{count}, {end}]")
        browser.wait(lambda: evaluate(browser, end) >= first[1] + 2000, "two seconds more")
        assert evaluate(browser, count) <= 1200
        assert browser.problems == []


@pytest.mark.slow
def test_drag_zooms_all_plots_and_double_click_returns(browser):
    with serve_panels("day") as (address, queue):
        open_page(browser, address, "day", 1280)
        panels = queue.get(timeout=20.0)
        ranges = (
            "[...new Set(found('Figure').map((each) => each.model.x_range).filter((range) => range.end > 1e12))].length"
        )
        assert evaluate(browser, ranges) == 1
        left, top, width, height = evaluate(
            browser,
            "((box) => [box.left, box.top, box.width, box.height])(found('Figure')[0].el.getBoundingClientRect())",
        )
        x, y = left + 0.3 * width, top + 0.6 * height
        mouse(browser, "mousePressed", x, y)
        mouse(browser, "mouseMoved", x + 60.0, y)
        mouse(browser, "mouseReleased", x + 60.0, y)
        shown_range = panels.times.range
        browser.wait(lambda: panels.times.is_paused and shown_range.end - shown_range.start < 300e3, "paused, zoomed")
        assert shown_range.end - shown_range.start > 20e3
        before = panels.times.range.end
        browser.wait(lambda: panels.times._latest_range[1] > before, "time goes on")
        assert panels.times.range.end == before

        def is_live_again():
            """Double-click and return True if the plots are live; on a busy computer two clicks can be too slow."""
            for count in (1, 2):
                mouse(browser, "mousePressed", x, y, count)
                mouse(browser, "mouseReleased", x, y, count)
            time.sleep(1.0)
            return not panels.times.is_paused and shown_range.end - shown_range.start > 300e3

        browser.wait(is_live_again, "live again")
        assert panels.times.range.end - panels.times.range.start == pytest.approx(600e3)
        assert panels.times.range.end >= NOW_NS * 1e-6


def has_text_at(browser, view):
    """True if a tooltip appears after the pointer has moved across a plot; the plot may not be laid out yet."""
    box = f"((box) => [box.left + box.width / 2, box.top + box.height * 0.3])({view}.el.getBoundingClientRect())"
    x, y = evaluate(browser, box)
    for step in range(-10, 1):
        browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=x + step, y=y, button="none")
    return browser.evaluate("document.querySelector('.bk-Tooltip')?.checkVisibility()")


def mouse(browser, kind, x, y, count=1):
    browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=count)
