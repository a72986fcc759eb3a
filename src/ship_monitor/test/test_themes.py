"""Colours of the page: contrast on the panel, and red light only at night."""

from dataclasses import fields

import pytest

from ship_monitor.themes import THEMES, Theme


def test_night_colours_are_red_light() -> None:
    # Green and blue light bleach the eye's rhodopsin: they are at most a quarter of red, the hue of the theme's text.
    for colour in colours(THEMES["night"]):
        red, green, blue = (int(colour[start : start + 2], 16) for start in (1, 3, 5))
        assert max(green, blue) <= 0.26 * red, colour


@pytest.mark.parametrize(
    ("name", "text", "second_text", "safe", "old"),
    # Contrasts from the design of the page, with its digits.
    [("day", 15, 7.9, 8.8, 4.7), ("dusk", 12, 6.0, 6.2, 3.8), ("night", 5.9, 4.6, 4.6, 3.1)],
)
def test_contrasts_against_the_panel(name: str, text: float, second_text: float, safe: float, old: float) -> None:
    theme = THEMES[name]
    assert contrast(theme.text, theme.panel) == pytest.approx(text, abs=0.5)
    assert contrast(theme.second_text, theme.panel) == pytest.approx(second_text, abs=0.06)
    assert contrast(theme.safe, theme.panel) == pytest.approx(safe, abs=0.06)
    assert contrast(theme.old, theme.panel) == pytest.approx(old, abs=0.06)


@pytest.mark.parametrize("theme", THEMES.values(), ids=lambda theme: theme.name)
def test_words_on_fills_are_legible(theme: Theme) -> None:
    # WCAG 2.1, 1.4.3: 4.5 for text; 3 for large text, such as the word CAUTION.
    assert contrast(theme.unsafe_word, theme.unsafe_fill) >= 4.5
    assert contrast(theme.caution_word, theme.caution_fill) >= 3.0


def colours(theme: Theme) -> list[str]:
    """Return all colours of a theme."""
    found: list[str] = []
    for field in fields(theme):
        value = getattr(theme, field.name)
        found += [] if field.name == "name" else [value] if isinstance(value, str) else list(value)
    return found


def contrast(first: str, second: str) -> float:
    """Return the contrast ratio of two colours after WCAG 2.1."""
    lighter, darker = sorted((luminance(first), luminance(second)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def luminance(colour: str) -> float:
    """Return the relative luminance of ``#RRGGBB`` after WCAG 2.1."""
    parts = [int(colour[start : start + 2], 16) / 255 for start in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
