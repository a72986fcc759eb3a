"""Keys of the terminal view, with textual's pilot."""

import asyncio
import dataclasses

import pytest

from ship_monitor.commands.monitor_terminal import is_utf8_locale
from ship_monitor.terminal.app import TerminalApp, _Lines, styles_of
from ship_monitor.terminal.styled_text import TextStyle
from ship_monitor.themes import THEMES
from ship_testing.suite_states import SHIFTED_SENSOR_ALERT, plain_text, state_with_mounting_shift


class Suite:
    """A suite with one state, which records its calls."""

    label, name, location = "LIVE", "demo", "namespace /demo, domain 7"

    def __init__(self):
        self.picture = state_with_mounting_shift()
        self.acknowledged = []
        self.ticks = 0

    def tick(self):
        self.ticks += 1

    def current_state(self):
        return self.picture

    def acknowledge(self, alert_id, instance):
        self.acknowledged.append((alert_id, instance))
        return f"acknowledged {alert_id}"


def rows(app):
    return [plain_text(line).rstrip() for line in app.query_one(_Lines)._lines]


def run(use, size=(80, 24)):
    """Run an app without a terminal; `use` presses keys."""

    async def session():
        suite = Suite()
        app = TerminalApp(suite)
        async with app.run_test(size=size) as pilot:
            await pilot.pause()
            await use(app, pilot, suite)
        return app

    return asyncio.run(session())


def test_key_a_acknowledges_the_displayed_instance():
    async def use(app, pilot, suite):
        await pilot.press("a")
        await app.workers.wait_for_complete()
        assert suite.acknowledged == [("star.starboard.out", 2)]
        assert rows(app)[-1] == " acknowledged star.starboard.out"
        suite.picture = state_with_mounting_shift(alerts=(dataclasses.replace(SHIFTED_SENSOR_ALERT, state=3),))
        await pilot.press("a")
        assert suite.acknowledged == [("star.starboard.out", 2)]
        assert rows(app)[-1] == " no alert to acknowledge"

    run(use)


def test_enter_shows_details_of_the_selection_and_goes_back():
    async def use(app, pilot, suite):
        first = rows(app)
        await pilot.press("down", "enter")
        assert rows(app)[2].startswith("── heading ─")
        await pilot.press("enter")
        assert rows(app)[4].startswith(">HEADING")
        await pilot.press("up", "enter")
        assert rows(app)[2].startswith("── weather ─")
        await pilot.press("escape", "escape")
        assert rows(app) == first
        await pilot.press("enter")
        assert rows(app)[2].startswith("── alerts ─")

    run(use)


def test_key_p_pauses_the_display():
    async def use(app, pilot, suite):
        await pilot.press("p")
        held = rows(app)[4]
        suite.picture = state_with_mounting_shift(angles=(), alerts=())
        app.draw()
        assert "PAUSED" in rows(app)[0]
        assert rows(app)[4] == held
        assert rows(app)[1] == " no alerts"
        await pilot.press("p")
        assert "PAUSED" not in rows(app)[0]
        assert rows(app)[4] != held

    run(use)


def test_key_t_switches_the_theme():
    async def use(app, pilot, suite):
        names = []
        for _ in range(4):
            names.append(app._theme_name)
            await pilot.press("t")
        assert names == ["day", "dusk", "night", "day"]

    run(use)


@pytest.mark.parametrize(("key", "code"), [("q", 0), ("ctrl+c", 130)])
def test_keys_that_end_it(key, code):
    async def use(app, pilot, suite):
        await pilot.press(key)

    assert run(use).return_value == code


def test_question_mark_shows_help():
    async def use(app, pilot, suite):
        await pilot.press("question_mark")
        assert any("SAFE" in row for row in rows(app))
        await pilot.press("question_mark")
        assert rows(app)[4].startswith(" HEADING")

    run(use)


def test_new_size_is_used_at_once():
    async def use(app, pilot, suite):
        await pilot.resize_terminal(40, 10)
        await pilot.pause()
        assert rows(app)[0].startswith("CAUTION heading, roll")
        await pilot.resize_terminal(100, 40)
        await pilot.pause()
        assert len(rows(app)) == 40

    run(use)


def test_messages_are_processed_while_drawing():
    async def use(app, pilot, suite):
        await pilot.pause(0.6)
        assert suite.ticks >= 1

    run(use)


def test_invalid_message_is_skipped():
    async def use(app, pilot, suite):
        def fail():
            suite.ticks += 1
            raise ValueError("7 is not a priority")

        suite.tick = fail
        await pilot.pause(0.7)
        assert suite.ticks >= 2
        assert rows(app)[-1] == " message skipped: ValueError: 7 is not a priority"
        assert rows(app)[4].startswith(" HEADING")

    run(use)


@pytest.mark.parametrize("theme", THEMES.values(), ids=THEMES.keys())
def test_urgent_styles_differ_without_colour(theme):
    styles = styles_of(theme)
    assert set(styles) == set(TextStyle)
    attributes = {look: (style.bold, style.reverse, style.strike) for look, style in styles.items()}
    assert len({attributes[look] for look in (TextStyle.TEXT, TextStyle.CAUTION, TextStyle.UNSAFE, TextStyle.OLD)}) == 4
    assert attributes[TextStyle.CAUTION][1]
    assert attributes[TextStyle.UNSAFE][1]


@pytest.mark.parametrize(
    ("environment", "shows"),
    [
        ({"LANG": "de_DE.UTF-8"}, True),
        ({"LANG": "C.utf8"}, True),
        ({"LANG": "de_DE.UTF-8", "LC_ALL": "C"}, False),
        ({"LANG": "de_DE.ISO-8859-1"}, False),
        ({}, False),
        ({"LC_CTYPE": "C.UTF-8"}, False),  # set by Python itself (PEP 538)
        ({"LC_CTYPE": "en_GB.UTF-8", "LANG": "C"}, True),
    ],
)
def test_utf8_from_the_locale(environment, shows):
    assert is_utf8_locale(environment) is shows
