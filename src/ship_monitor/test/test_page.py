"""The page in a browser: headless Chromium with hand-made states."""

import json
from dataclasses import replace
from pathlib import Path
from zoneinfo import ZoneInfo

import matplotlib
import numpy as np
import pytest

from ship_monitor.page.panels import InputsPanel
from ship_monitor.plots.innovation_panel import InnovationPanel
from ship_monitor.plots.sky_panel import SkyPanel
from ship_testing import browser as browser_module
from ship_testing import suite_states
from ship_testing.browser import Browser
from ship_testing.monitored_histories import simulated_history, simulated_state
from ship_testing.page_runs import StateSource, run_page_server
from ship_watch.suite_state import ANGLES, Safety

pytestmark = pytest.mark.skipif(browser_module.CHROMIUM is None, reason="there is no Chromium on this machine")

SIZES = {"watch": (1280, 800), "phone": (390, 844)}
LAPTOP = (1366, 768)
LIVE = (
    "!document.documentElement.classList.contains('nolink') && document.querySelector('#utc').textContent > '12:00:07'"
)


@pytest.fixture(scope="module")
def browser():
    browser = Browser()
    yield browser
    browser.close()


@pytest.fixture
def source():
    return StateSource()


@pytest.fixture
def page(source):
    with run_page_server(source) as server:
        yield server.address


def rectangle(browser, selector):
    return browser.evaluate(
        f"(({{left, top, width, height}}) => [left, top, width, height])"
        f"(document.querySelector('{selector}').getBoundingClientRect())"
    )


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["day", "dusk", "night"])
@pytest.mark.parametrize("size", SIZES)
def test_first_screen_is_drawn_completely(browser, source, page, theme, size, tmp_path):
    source.set(suite_states.state_with_two_faults(), suite_states.history(is_faulty=True))
    browser.open(f"{page}?theme={theme}", *SIZES[size])
    browser.wait_until_true(LIVE)
    browser.take_screenshot(tmp_path / f"{theme}_{size}.png")
    assert browser.problems == []
    assert [
        address for address in browser.addresses if not address.startswith((page, page.replace("http", "ws")))
    ] == []
    words = [browser.text(f"#{name} .state b") for name in ("heading", "pitch", "roll", "azimuth", "elevation")]
    assert words == ["CAUTION", "SAFE", "CAUTION", "UNSAFE", "UNSAFE"]
    assert browser.text("#heading .digits") == "034.39"
    assert browser.text("#azimuth .size") == "OLD 12 s"
    assert browser.evaluate("getComputedStyle(document.querySelector('#azimuth .digits')).textDecorationLine") == (
        "line-through"
    )
    assert browser.text("#outs") == "star.starboard OUTencoder OUT"
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth"), "wider than the window"
    assert browser.evaluate("getComputedStyle(document.body).fontFamily").startswith("B612")


def test_first_screen_at_1280_by_800_matches_the_design(browser, page):
    browser.open(page)
    browser.wait_until_true(LIVE)
    assert rectangle(browser, "#bar") == [0, 0, 1280, 64]
    assert rectangle(browser, "#heading") == pytest.approx([16, 76, 276, 268], abs=1.0)
    assert rectangle(browser, "#ages")[:2] == pytest.approx([588, 354], abs=1.0)
    assert rectangle(browser, "#sources") == pytest.approx([876, 76, 388, 546], abs=1.0)
    assert rectangle(browser, "#ribbons") == pytest.approx([16, 632, 1248, 160], abs=1.0)


# Minimum font sizes for reading at two metres and at one metre, px, on a screen 1280 px wide (design of the page).
@pytest.mark.slow
@pytest.mark.parametrize(
    ("selector", "least_px"),
    [
        ("#heading .number", 64),
        ("#heading .accuracy", 38),
        ("#heading .state", 36),
        ("#ages dd", 40),
        ("#utc", 36),
        ("#outs b", 29),
        ("#alert-text", 19),
        ("#sources li", 19),
        ("#heading h2", 19),
    ],
)
def test_font_sizes_for_reading_at_a_distance(browser, source, page, selector, least_px):
    source.set(suite_states.state_with_two_faults())
    browser.open(page)
    browser.wait_until_true(LIVE)
    assert browser.evaluate(f"parseFloat(getComputedStyle(document.querySelector('{selector}')).fontSize)") >= least_px


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_fallback_font_cuts_nothing_and_console_is_empty(source, page, size, tmp_path, monkeypatch):
    """Without B612 the server provides DejaVu for page and plots; DejaVu is wider."""
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    (tmp_path / "fonts.conf").write_text(
        f'<?xml version="1.0"?><!DOCTYPE fontconfig SYSTEM "fonts.dtd"><fontconfig><dir>{fonts}</dir>'
        f"<cachedir>{tmp_path}/cache</cachedir></fontconfig>"
    )
    monkeypatch.setenv("FONTCONFIG_FILE", str(tmp_path / "fonts.conf"))
    source.set(suite_states.state_with_two_faults())
    plain = Browser()
    try:
        plain.open(page, *SIZES[size])
        plain.wait_until_true(LIVE)
        plain.evaluate("document.fonts.ready.then(() => true)")
        plain.take_screenshot(tmp_path / "page.png")
        assert any(address.endswith("DejaVuSans-Bold.ttf") for address in plain.addresses)
        wide = "[...document.querySelectorAll('.tile,.number,#foot')].filter((e) => e.scrollWidth > e.clientWidth)"
        assert plain.evaluate(f"{wide}.map((each) => each.id || each.className)") == []
        if size == "phone":
            plain.evaluate("document.querySelector('#plots-wanted').click()")
        plain.evaluate("document.querySelector('#panels').scrollIntoView()")
        plain.wait_until_true(
            f"{INSIDE}.some((each) => each.tagName === 'CANVAS' && each.width > 100 && each.height > 50)"
        )
        assert plain.problems == []
    finally:
        plain.close()


def test_reason_fits_its_tile_on_a_phone(browser, source, page):
    source.set(suite_states.state_with_two_faults())
    browser.open(page, *SIZES["phone"])
    browser.wait_until_true(LIVE)
    below = "[...document.querySelectorAll('.tile')].filter((each) => each.scrollHeight > each.clientHeight)"
    assert browser.evaluate(f"{below}.map((each) => each.id)") == []


def test_phone_layout(browser, page):
    browser.open(page, *SIZES["phone"])
    browser.wait_until_true(LIVE)
    tops = [rectangle(browser, selector)[1] for selector in ("#alert", "#heading", "#elevation", "#ages", "#sources")]
    assert tops == sorted(tops)
    assert rectangle(browser, "#heading")[3] == pytest.approx(92, abs=1.0)
    assert rectangle(browser, "#heading")[2] > 370


def test_values_change_without_reload(browser, source, page):
    browser.open(page)
    browser.wait_until_true(LIVE)
    well = suite_states.suite_state()
    heading = replace(well.angles[0], value=1.0, safety=Safety.UNSAFE, reason="all stars rejected")
    source.set(replace(well, angles=(heading, *well.angles[1:])))
    browser.wait_until_true("document.querySelector('#heading .digits').textContent === '057.30'")  # 1 rad
    assert browser.text("#heading .reason") == "all stars rejected"
    assert browser.evaluate("document.querySelector('#heading').dataset.safety") == "UNSAFE"
    assert browser.problems == []


@pytest.mark.slow
def test_lost_link_makes_every_value_old(browser, source, page):
    browser.open(page)
    browser.wait_until_true(LIVE)
    source.fails = True
    browser.wait_until_true("document.documentElement.classList.contains('nolink')")
    assert browser.text("#alert-text").startswith("NO LINK")
    assert browser.text("#heading .state b") == "UNSAFE"
    assert browser.text("#heading .size").startswith("OLD ")
    source.fails = False
    browser.wait_until_true(LIVE)
    assert browser.text("#heading .state b") == "SAFE"


def test_lost_link_is_reported_within_two_seconds(browser, page):
    browser.open(page)
    browser.wait_until_true(LIVE)
    # The page detects the loss by its own clock and timers: their limits are compared, not times of this test.
    limits = browser.evaluate("[monitor.limits.linkLostMs, monitor.limits.lookMs]")
    assert sum(limits) <= 2000


def test_busy_page_does_not_report_a_lost_link(browser, page):
    """Opening the plots keeps a page busy: texts received meanwhile are read later."""
    browser.open(page)
    browser.wait_until_true(LIVE)
    browser.evaluate(
        "window.losses = 0; new MutationObserver(() => {"
        " losses += document.documentElement.classList.contains('nolink'); })"
        ".observe(document.documentElement, { attributes: true });"
        "setTimeout(() => { const endMs = performance.now() + monitor.limits.linkLostMs + 1000;"
        " while (performance.now() < endMs); window.wasBusy = true; }, 0)"
    )
    browser.wait_until_true("window.wasBusy")
    clock = browser.text("#utc")
    browser.wait_until_true(f"document.querySelector('#utc').textContent > '{clock}'")
    assert browser.evaluate("losses") == 0


@pytest.mark.slow
def test_page_reconnects_after_a_restart_of_the_server(browser, source):
    with run_page_server(source) as server:
        port = int(server.address.rstrip("/").rpartition(":")[2])
        browser.open(server.address)
        browser.wait_until_true(LIVE)
        browser.evaluate("window.isFormerPage = true")
    browser.wait_until_true("document.documentElement.classList.contains('nolink')")
    with run_page_server(source, port):
        browser.wait_until_true(f"!window.isFormerPage && typeof monitor === 'object' && {LIVE}", 60.0)
        assert browser.text("#heading .state b") == "SAFE"


def test_keys_choose_the_theme_and_pause_the_plots(browser, page):
    browser.open(page)
    browser.wait_until_true(LIVE)
    browser.press(" ")
    assert browser.wait_until_true("!document.querySelector('#paused').hidden")
    browser.press(" ")
    assert browser.wait_until_true("document.querySelector('#paused').hidden")
    browser.press("3")
    browser.wait_until_true("document.documentElement.className.includes('night')")
    assert browser.evaluate("getComputedStyle(document.documentElement).backgroundColor") == "rgb(0, 0, 0)"
    assert browser.evaluate("location.search") == "?theme=night"


def test_the_alert_line_opens_the_list(browser, source, page):
    source.set(suite_states.state_with_two_faults())
    browser.open(page)
    browser.wait_until_true(LIVE)
    browser.evaluate("document.querySelector('#alert').click()")
    assert browser.text("#alerts p:nth-child(2) span") == "WARNING · star.starboard out"
    assert browser.text("#alerts p:nth-child(2) .advice").startswith("Clean the sensor")


def test_click_on_a_source_marks_it(browser, page):
    browser.open(page)
    browser.wait_until_true(LIVE)
    browser.evaluate("document.querySelector('#sources li:nth-child(2)').click()")
    assert browser.text("#sources li.marked .who") == "star.fore"


def test_hovering_shows_all_digits_in_the_colours_of_the_theme(browser, page):
    browser.open(f"{page}?theme=night")
    browser.wait_until_true(LIVE)
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=100, y=150)
    browser.wait_until_true("!document.querySelector('#tip').hidden")
    assert browser.text("#tip").startswith("34.392000°\nσ 1.684″")
    assert browser.evaluate("getComputedStyle(document.querySelector('#tip')).color") == "rgb(255, 64, 38)"


def test_names_from_the_network_are_plain_text(browser, source, page):
    well = suite_states.suite_state()
    evil = "</script><img src=x onerror=window.hit=1>"
    source.set(replace(well, sources=(replace(well.sources[0], name=evil), *well.sources[1:])))
    browser.open(page)
    browser.wait_until_true(LIVE)
    assert browser.text("#sources li .who") == evil
    assert browser.evaluate("window.hit") is None


def test_many_sources_are_counted_and_out_ones_are_visible(browser, source, page):
    faulty = suite_states.state_with_two_faults()
    more = tuple(suite_states.source(f"reference.{number}") for number in range(20))
    source.set(replace(faulty, sources=faulty.sources + more))
    browser.open(page)
    browser.wait_until_true(LIVE)
    assert browser.text("#more").endswith(" more in")
    list_bottom = "document.querySelector('#sources').getBoundingClientRect().bottom"
    assert browser.evaluate(f"document.querySelector('#more').getBoundingClientRect().bottom <= {list_bottom}")


@pytest.mark.slow
def test_suite_without_a_theodolite_has_no_empty_tiles(browser, source, page):
    well = suite_states.suite_state()
    source.set(replace(well, angles=well.angles[:3], pointing_by=""))
    browser.open(page)
    browser.wait_until_true(LIVE)
    tiles = "[...document.querySelectorAll('.tile')].filter((each) => each.offsetHeight).map((each) => each.id)"
    assert browser.evaluate(tiles) == ["heading", "pitch", "roll", "ages"]
    rows = [rectangle(browser, f"#{name}") for name in ("heading", "pitch", "roll", "ages")]
    assert [row[2] for row in rows] == pytest.approx([420] * 4, abs=2.0)
    assert rows[2][1] == rows[3][1] > rows[0][1] == rows[1][1]


def colour(browser, selector):
    return browser.evaluate(f"getComputedStyle(document.querySelector('{selector}')).color")


OLD_COLOUR = "rgb(127, 140, 153)"
GREY = (".ages dd", "#head", "#sources li .who", "#sources li .age", "#sources li svg")


@pytest.mark.slow
@pytest.mark.parametrize("is_linked", [True, False])
def test_old_data_have_no_ticks_ages_or_counts(browser, source, page, is_linked):
    browser.open(page)
    browser.wait_until_true(LIVE)
    assert OLD_COLOUR not in [colour(browser, each) for each in GREY]
    if is_linked:
        source.set(suite_states.suite_state(*suite_states.angles_timed_out(*ANGLES, age_s=19.0)))
        browser.wait_until_true("document.documentElement.classList.contains('stale')")
    else:
        source.fails = True
        browser.wait_until_true("document.documentElement.classList.contains('nolink')")
    assert {each: colour(browser, each) for each in GREY} == dict.fromkeys(GREY, OLD_COLOUR)
    glyphs = "[...document.querySelectorAll('#sources li use')].map((each) => each.getAttribute('href'))"
    assert set(browser.evaluate(glyphs)) == {"#unknown"}
    assert browser.text("#head") == "last: 8 of 8 in"
    assert browser.text("#overall b") == "UNSAFE"
    if not is_linked:
        assert browser.text(".ages dd") != "0.5 s", "it grows older"


@pytest.mark.slow
@pytest.mark.parametrize("size", [*SIZES.values(), LAPTOP])
def test_safety_and_alert_stay_visible_while_scrolled(browser, source, page, size):
    source.set(suite_states.state_with_two_faults())
    browser.open(page, *size)
    browser.wait_until_true(LIVE)
    assert not browser.evaluate("document.querySelector('#states').offsetHeight")
    browser.evaluate("scrollTo(0, innerHeight)")
    browser.wait_until_true("document.querySelector('#states').offsetHeight")
    states = "[...document.querySelectorAll('#states .chip')].map((each) => each.dataset.safety)"
    assert browser.evaluate(states) == ["CAUTION", "SAFE", "CAUTION", "UNSAFE", "UNSAFE"]
    for selector in ("#states", "#alert-text", "#overall b"):
        left, top, width, height = rectangle(browser, selector)
        assert 0 <= top < top + height < 260, selector
        assert 0 <= left < left + width <= size[0], selector
    assert browser.text("#overall").startswith("UNSAFE")


@pytest.mark.slow
def test_time_axis_is_visible_at_1366_by_768(browser, page):
    browser.open(page, *LAPTOP)
    browser.wait_until_true(LIVE)
    assert browser.evaluate("document.querySelector('#ticks span').getBoundingClientRect().bottom") <= LAPTOP[1]


@pytest.mark.slow
@pytest.mark.parametrize("size", [SIZES["watch"], LAPTOP])
def test_list_is_readable_with_two_sources_out(browser, source, page, size):
    source.set(suite_states.state_with_two_faults())
    browser.open(page, *size)
    browser.wait_until_true(LIVE)
    assert browser.evaluate("document.querySelector('#more').hidden"), "all eight are listed"
    cut = "[...document.querySelectorAll('#sources li')].filter((each) => each.scrollHeight > each.clientHeight + 1)"
    assert browser.evaluate(f"{cut}.length") == 0


@pytest.mark.slow
def test_phone_texts_do_not_overlap(browser, source, page):
    source.set(suite_states.state_with_two_faults())
    browser.open(page, *SIZES["phone"])
    browser.wait_until_true(LIVE)
    word, state = rectangle(browser, "#azimuth .state b"), rectangle(browser, "#azimuth .state")
    stripe = "getComputedStyle(document.querySelector('#azimuth .state'), '::after')"
    stripe_px = browser.evaluate(f"parseFloat({stripe}.width)")
    assert word[0] + word[2] <= state[0] + state[2] - stripe_px
    assert rectangle(browser, "#azimuth .state svg")[0] >= state[0] + stripe_px
    _, top, _, height = rectangle(browser, "#azimuth .number")
    assert rectangle(browser, "#azimuth .reason")[1] >= top + height - 1


@pytest.mark.slow
def test_local_time_is_shown_with_utc(browser, source):
    with run_page_server(source, zone=ZoneInfo("Europe/Oslo")) as server:
        browser.open(server.address)
        browser.wait_until_true(LIVE)
        assert browser.text("#local").startswith("14:00:")
        assert browser.text("#local").endswith(" CEST")


def test_waiting_page_names_output_and_location(browser, source, page):
    source.set(replace(suite_states.suite_state(), waiting_for="ship/attitude", utc_ns=0))
    browser.open(page)
    browser.wait_until_true("document.querySelector('#alert-text').textContent === 'waiting for ship/attitude'")
    assert browser.text("#alert-sub") == "namespace /demo, domain 0"


def test_first_paint_does_not_wait_for_bokeh(browser, page):
    browser.open(page)
    browser.wait_until_true(LIVE)
    # Both times are from the browser's timeline, so that a loaded computer delays both.
    painted, loaded = browser.evaluate(
        "[performance.getEntriesByName('first-contentful-paint')[0].startTime,"
        " performance.getEntriesByType('resource').find((each) => each.name.includes('bokeh')).responseEnd]"
    )
    sent = browser.evaluate("performance.getEntriesByType('navigation')[0].responseEnd")
    print(f"page there after {sent:.0f} ms, painted {painted:.0f} ms, bokeh there {loaded:.0f} ms")
    assert painted - sent < 1000.0


# Bokeh draws into shadow roots: this expression returns the elements inside all of them.
INSIDE = """(() => {
  const found = [], look = (root) => root.querySelectorAll('*').forEach((each) => {
    found.push(each);
    if (each.shadowRoot) look(each.shadowRoot);
  });
  look(document.querySelector('#panels'));
  return found;
})()"""
TITLES = [
    *("Innovations by source", "Error inside", "Sky", "Lights on the detector", "Error budget", "Events"),
    *("Alignment and calibration", "Inputs"),
]


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("theme", ["dusk", "night"])
def test_panels_are_drawn_when_they_become_visible(browser, source, page, theme, size, tmp_path):
    source.set(simulated_state(), simulated_history())
    browser.open(f"{page}?theme={theme}", *SIZES[size])
    browser.wait_until_true("monitor.isLinked()")
    assert browser.evaluate(f"{INSIDE}.filter((each) => each.tagName === 'CANVAS').length") == 0, "they rest"
    if size == "phone":
        browser.evaluate("document.querySelector('#plots-wanted').click()")
    browser.evaluate("document.querySelector('#panels').scrollIntoView()")
    for title in TITLES:
        is_bold = f"each.tagName === 'B' && each.textContent.startsWith('{title}')"
        browser.wait_until_true(f"{INSIDE}.some((each) => {is_bold})")
    drawn = f"{INSIDE}.filter((each) => each.tagName === 'CANVAS' && each.width > 100 && each.height > 50).length"
    assert browser.wait_until_true(f"{drawn} >= 10 && {drawn}") >= 10
    browser.take_screenshot(tmp_path / f"panels_{theme}_{size}.png", whole=True)
    assert browser.problems == []
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth"), "wider than the window"


# Text after a panel's title, and true if the panel is within the window.
PANEL = f"""((title) => {{
  const box = {INSIDE}.find((each) => each.tagName === 'B' && each.textContent.startsWith(title));
  const panel = box.getRootNode().host.getRootNode().host.getBoundingClientRect();
  return [box.nextSibling.textContent, panel.top >= 0 && panel.bottom <= innerHeight];
}})"""
FIGURES = """(() => {
  const found = [], walk = (view) => {
    if (view.model.type === 'Figure') found.push(view.model);
    for (const each of view.child_views ?? []) walk(each);
  };
  for (const root of Bokeh.index) walk(root);
  return found;
})()"""
MARKED = f"""(() => {{
  const titled = {FIGURES}.map((each) => each.title?.text ?? '').filter((text) => text.startsWith('▶'));
  const framed = {FIGURES}.filter((each) => each.outline_line_width === 3).length;
  const rows = {INSIDE}.filter((each) => each.tagName === 'TR' && each.classList.contains('marked')).length;
  const states = {FIGURES}.flatMap((each) => [...each.left, ...each.right])
    .flatMap((axis) => axis.major_label_overrides ?? [])
    .flatMap((data) => data instanceof Map ? [...data.values()] : Object.values(data))
    .filter((text) => String(text).startsWith('▶'));
  return [titled.length, framed, rows, states.length];
}})()"""
"""Titles, frames, rows of tables and labels of axes that are marked in the panels."""


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_click_on_a_tile_shows_its_budget_and_error(browser, source, page, size):
    source.set(simulated_state(), simulated_history())
    browser.open(page, *SIZES[size])
    browser.wait_until_true("monitor.isLinked()")
    browser.evaluate("document.querySelector('#roll').click()")
    # The panels are made and drawn during this wait.
    browser.wait_until_true(f"{PANEL}('Error budget')[0].startsWith('roll, ')", 90.0)
    browser.wait_until_true(f"{FIGURES}.some((each) => each.title?.text === '▶ roll')")
    assert browser.wait_until_true(f"{PANEL}('Error budget')[1] && {PANEL}('Error inside')[1]")


@pytest.mark.slow
def test_panels_are_placed_one_by_one_with_text_updates_between(browser, source, page):
    source.set(simulated_state(), simulated_history())
    browser.open(page, 1280, 1600)
    browser.wait_until_true("monitor.isLinked()")
    # Number of plots in the document at each text update: updates between the plots keep the link.
    browser.evaluate(
        "window.plots = []; const show = monitor.show; monitor.show = (model) => {"
        " plots.push([...Bokeh.documents[0]._all_models.values()].filter((each) => each.type === 'Figure').length);"
        " show(model); }"
    )
    browser.evaluate("document.querySelector('#panels').scrollIntoView()")
    titles = f"{FIGURES}.map((each) => each.title?.text ?? '')"
    for title in ("heading", "pitch", "roll", "elevation"):
        browser.wait_until_true(f"{titles}.includes('{title}')", 90.0)
    for name in ("star.fore", "star.starboard", "lights"):
        browser.wait_until_true(f"{titles}.some((each) => each.includes('{name}'))", 90.0)
    browser.wait_until_true("plots.at(-1) === 14", 90.0)
    assert max(np.diff(browser.evaluate("plots"))) <= 3  # the plots of one panel
    assert browser.problems == []


def wait_for_marks(browser, each):
    """Wait until this number of titles, frames, rows and labels is marked."""
    browser.wait_until_true(f"JSON.stringify({MARKED}) === '{json.dumps([each] * 4, separators=(',', ':'))}'")


@pytest.mark.slow
def test_mark_is_in_every_panel_until_escape(browser, source, page):
    source.set(simulated_state(), simulated_history())
    browser.open(page, 1280, 4000)  # all panels in sight
    browser.wait_until_true("monitor.isLinked()")
    browser.wait_until_true(f"{FIGURES}.length === 14")
    wait_for_marks(browser, 0)
    browser.evaluate("document.querySelector('#sources li:nth-child(1)').click()")
    # Two of each: titles and frames of the sensor's innovations and field of view, rows of its input and alert, and
    # labels of the two parts of the budget that star sensors contribute.
    wait_for_marks(browser, 2)
    clock = browser.text("#utc")
    browser.wait_until_true(f"document.querySelector('#utc').textContent > '{clock}'")
    wait_for_marks(browser, 2)
    assert browser.text("#sources li.marked .who") == "star.starboard"
    other = Browser()
    try:
        other.open(page, 1280, 4000)
        other.wait_until_true(f"{FIGURES}.length === 14")
        wait_for_marks(other, 0)
    finally:
        other.close()
    browser.evaluate("document.dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape'}))")
    wait_for_marks(browser, 0)
    assert browser.evaluate("document.querySelector('#sources li.marked')") is None
    browser.evaluate("document.querySelector('#sources li:nth-child(2)').click()")
    browser.wait_until_true(f"{MARKED}[0] === 2")
    browser.evaluate("document.querySelector('#sources li:nth-child(2)').click()")
    browser.wait_until_true(f"{MARKED}[0] === 0")
    assert browser.problems == []


@pytest.mark.slow
def test_change_of_theme_keeps_the_mark(browser, source, page):
    source.set(simulated_state(), simulated_history())
    browser.open(page)
    browser.wait_until_true("monitor.isLinked()")
    browser.evaluate("document.querySelector('#sources li:nth-child(1)').click()")
    browser.press("3")
    browser.wait_until_true("document.documentElement.className.includes('night') && monitor.isLinked()")
    assert browser.text("#sources li.marked .who") == "star.starboard"
    browser.evaluate("document.querySelector('#panels').scrollIntoView()")
    browser.wait_until_true(f"{MARKED}[0] > 0")


@pytest.mark.slow
def test_only_visible_panels_are_drawn(browser, source, page, monkeypatch):
    drawn = []
    for kind in (InnovationPanel, SkyPanel, InputsPanel):
        update = kind.update

        def record_update(self, *arguments, kind=kind, update=update, **options):
            drawn.append(kind)
            update(self, *arguments, **options)

        monkeypatch.setattr(kind, "update", record_update)
    source.set(simulated_state(), simulated_history())
    browser.open(page)
    browser.wait_until_true("monitor.isLinked()")
    for where, wanted, unwanted in (
        ("document.querySelector('#panels').scrollIntoView()", InnovationPanel, InputsPanel),
        ("scrollTo(0, document.body.scrollHeight)", InputsPanel, InnovationPanel),
    ):

        def is_drawn_only(where=where, wanted=wanted, unwanted=unwanted):
            browser.evaluate(where)  # repeated: the page grows while panels are added
            return wanted in drawn[-3:] and unwanted not in drawn[-3:]

        browser.wait(is_drawn_only, where, 90.0)
    browser.evaluate("scrollTo(0, 0)")

    def is_idle():
        """True if nothing was drawn while the time of the page advanced."""
        drawn.clear()
        clock = browser.text("#utc")
        browser.wait_until_true(f"document.querySelector('#utc').textContent > '{clock}'")
        return not drawn

    browser.wait(is_idle, "all rest")
    assert browser.problems == []
