"""Malicious names and texts from the network in a real browser: nothing is executed, all are shown unchanged."""

import re
from collections import deque
from dataclasses import replace

import pytest

from ship_monitor.plots.alignment_panel import state_text
from ship_testing import browser as browser_module
from ship_testing import suite_states
from ship_testing.browser import Browser
from ship_testing.monitored_histories import simulated_history, simulated_state
from ship_testing.page_runs import StateSource, run_page_server
from ship_watch.history.history import ParameterEstimate
from ship_watch.suite_state import Event, InputState, Presence

NAMES = {
    "markup": "</script></style><img src=x onerror=window.hit=1><svg onload=window.hit=1>&lt;b&gt;",
    "script": "'\"`${window.hit=1}`});window.hit=1;//--><script>window.hit=1</script>",
    "formula": r"a $$x^2$$ \(y\) \[z\] $\unknown{$ $$$ b",
    "template": "{{7*7}} {% raw %} @t{0.0} javascript:window.hit=1 \u202e\u2028\x00\x1b[31m",
}


def hostile(name):
    """Return a state and a history with the name in place of all names and texts from the network."""
    well = simulated_state()
    sources = [replace(each, name=f"{name} {number}", reason=name) for number, each in enumerate(well.sources)]
    sources = [replace(each, disagreement=name, presence=Presence.OUT) for each in sources[:2]] + sources[2:]
    picture = replace(
        well,
        sources=tuple(sources),
        angles=tuple(replace(each, reason=name) for each in well.angles),
        alerts=(replace(suite_states.SHIFTED_SENSOR_ALERT, id=name, source=name, text=name, unit=name),),
        events=(Event(suite_states.NOW_NS, "alert", name, name), Event(suite_states.NOW_NS, "state", name, "x")),
        inputs=(InputState(name, 2.0, 0.1, 0.6, 1, 81, {name: 9}),),
        pointing_by=name,
        horizon=name,
    )
    history = simulated_history()
    points = history.innovations.pop("star.fore")
    stars = history.star_exposures.pop("star.fore")
    history.innovations[f"star.{name}"] = points
    history.star_exposures[f"star.{name}"] = stars
    history.beacons[name] = history.beacons.pop("a")
    for topic, budget in history.budgets.items():
        history.budgets[topic] = deque(
            replace(
                each,
                by_angle={angle: {name: max(of.values()), **of} for angle, of in each.by_angle.items()},
            )
            for each in budget
        )
    history.alignment = (*history.alignment, ParameterEstimate(name, 0.5, 0.1, name, False, 0.0))
    return picture, history


@pytest.fixture(scope="module")
def browser():
    browser = Browser()
    yield browser
    browser.close()


ALL_TEXT = """(() => {
  const texts = [], look = (root) => root.querySelectorAll('*').forEach((each) => {
    for (const child of each.childNodes) if (child.nodeType === 3 && each.tagName !== 'STYLE') texts.push(child.data);
    if (each.shadowRoot) look(each.shadowRoot);
  });
  look(document);
  return texts.join('\\n');
})()"""
FIGURES = """(() => {
  const found = [], walk = (view) => {
    if (view.model.type === 'Figure') found.push(view.model);
    for (const each of view.child_views ?? []) walk(each);
  };
  for (const root of Bokeh.index) walk(root);
  return found;
})()"""


DRAWN = f"""{FIGURES}.flatMap((each) => [each.title?.text ?? '',
  ...[...each.left, ...each.right].flatMap((axis) => axis.major_label_overrides ?? [])
    .flatMap((data) => data instanceof Map ? [...data.values()] : Object.values(data)).map(String)])"""


@pytest.mark.slow
@pytest.mark.skipif(browser_module.CHROMIUM is None, reason="there is no Chromium on this machine")
@pytest.mark.parametrize("kind", NAMES)
def test_names_are_never_executed_in_the_page(browser, kind, caplog):
    name = NAMES[kind]
    source = StateSource()
    source.set(*hostile(name))
    source.label = source.name = source.location = name
    with run_page_server(source) as server:
        page = server.address
        browser.open(page, 1280, 4000)
        browser.wait_until_true("monitor.isLinked()")
        browser.wait_until_true(f"{FIGURES}.length >= 10", 90.0)
        clock = browser.text("#utc")
        browser.wait_until_true(f"document.querySelector('#utc').textContent > '{clock}'")
        assert browser.evaluate("window.hit") is None
        assert browser.problems == []
        assert [each for each in browser.addresses if not each.startswith((page, page.replace("http", "ws")))] == []
        assert not [record.getMessage() for record in caplog.records if record.exc_info]
        shown = browser.evaluate(ALL_TEXT)
        plain = name.replace("\x00", "").split("\u2028")[0]
        for place in ("#sources li .who", "#alert-text"):
            assert plain in browser.text(place).replace("\x00", ""), place
        assert shown.count(plain) >= 10
        assert browser.evaluate("document.images.length") == 0
        # Titles and labels, drawn on a canvas, are plain letters and no TeX formulas.
        drawn = browser.evaluate(DRAWN)
        assert any(plain.split()[0] in text.replace("\u2060", "") for text in drawn)
        assert not [text for text in drawn if re.search(r"\$\$|\\[(\[]", text)]


def test_state_in_an_unknown_unit_is_shown_in_it():
    assert state_text(ParameterEstimate("x", 0.5, 0.1, "furlong", True, 0.0)) == "+0.500 ± 0.200 furlong"
