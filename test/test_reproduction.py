"""docs/reproduction.md is the output of ``make reproduction``."""

import re

import matplotlib.pyplot as plt
import pytest

from ship_testing.places import ROOT
from tools import reproduction
from tools.papers import p15, w18
from tools.papers.figures import figures

NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?")


def test_numbers_are_compared_to_one_in_their_last_digit():
    assert differences("| a | 5.91″ | 12 |", "| a | 5.90″ | 13 |") == []
    assert differences("| a | 5.91″ |", "| a | 5.89″ |") == [("5.91", "5.89")]
    assert differences("| a | 5.91″ |", "| a | −5.91″ |") == [("5.91", "−5.91")]
    assert differences("| a | holds |", "| a | **does not** |") != []


def differences(first: str, second: str) -> list[tuple[str, str]]:
    """Return lines that differ in words, and numbers that differ by more than one in their last digit."""
    found = []
    for left, right in zip(first.splitlines(), second.splitlines(), strict=True):
        if NUMBER.sub("#", left) != NUMBER.sub("#", right):
            found.append((left, right))
        for one, other in zip(NUMBER.findall(left), NUMBER.findall(right), strict=False):
            last_digit = 10.0 ** -len(one.partition(".")[2])
            if not abs(value(one) - value(other)) <= 1.001 * last_digit:
                found.append((one, other))
    return found


def value(number: str) -> float:
    return float(number.replace("−", "-"))


@pytest.mark.slow
def test_the_page_is_what_the_command_computes():
    page = reproduction.PAGE.read_text(encoding="utf-8")
    computed = reproduction.page()
    assert len(page.splitlines()) == len(computed.splitlines()), "run make reproduction"
    assert differences(page, computed) == [], "run make reproduction"


def test_the_page_shows_every_picture():
    page = reproduction.PAGE.read_text(encoding="utf-8")
    names = []
    for name, figure in figures():
        names.append(name)
        plt.close(figure)
    assert names == [*(f"z14_figure_{number}" for number in range(1, 7)), "w18_figure_4"]
    for name in names:
        assert f"({reproduction.PICTURES}/{name}.png)" in page
        assert (ROOT / "docs" / reproduction.PICTURES / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_two_numbers_by_elementary_algebra():
    # 20" tan 60°; RTK 1 cm per axis and 30 cm times sqrt(6) degrees are most of 2.2 cm (models.md §5).
    assert w18.azimuth_of_tilt_arcsec() == pytest.approx(34.64, abs=0.005)
    assert w18.baseline_end_m() == pytest.approx(0.022, abs=0.0005)


def test_the_printed_elevations_of_the_worked_example_belong_together():
    assert pytest.approx(
        p15.PRINTED_RAISED_DEG, abs=1e-4
    ) == p15.PRINTED_ELEVATION_DEG + p15.PRINTED_REFRACTION_ARCSEC / 3600.0
