"""Limits of a ship: defaults, a file of a ship, and error texts for wrong files."""

from pathlib import Path

import pytest

from ship_bags.errors import BadInput
from ship_estimation.parameters.schema import build
from ship_watch.safety.limits import InputLimits, Limits, read_limits
from ship_watch.suite_state import ANGLES
from ship_watch.topics import SOURCE_KINDS

ARCSEC = 4.84813681109536e-06


def test_defaults_are_those_of_the_suite() -> None:
    """Defaults: heading 6″, tilt 4″, pointing 12″ at 95 %, one second for both outputs."""
    limits = Limits()
    in_arcsec = {angle: limits.angle_limit(angle) / ARCSEC for angle in ANGLES}
    assert in_arcsec == pytest.approx({"heading": 6, "pitch": 4, "roll": 4, "azimuth": 12, "elevation": 12})
    assert (limits.attitude_age_s, limits.pointing_age_s, limits.unsafe_factor) == (1.0, 1.0, 3.0)
    assert limits == build(Limits, {})


def test_file_of_a_ship_changes_only_its_own_limits(tmp_path: Path) -> None:
    """Other limits keep their defaults; an input has its own limits, else those of its kind, else ``every_input``."""
    path = tmp_path / "ship.yaml"
    path.write_text(
        "heading_arcsec: 8.0\nevery_input: {refusals: 7}\ninputs:\n  star: {rate_hz: 1.0}\n  star_bow: {rate_hz: 2.0}\n"
        "  gnss: {age_s: 20}\nalerts: {clear_after_s: 9.0}\n"
    )
    limits = read_limits(path)
    assert limits.angle_limit("heading") == pytest.approx(8.0 * ARCSEC)
    assert limits.tilt_arcsec == Limits().tilt_arcsec
    assert limits.input_limits("star.bow") == InputLimits(rate_hz=2.0)
    assert limits.input_limits("star.starboard") == InputLimits(rate_hz=1.0)
    assert limits.input_limits("gnss").age_s == 20.0
    assert limits.input_limits("ins").refusals == 7
    assert limits.alerts.clear_after_s == 9.0


@pytest.mark.parametrize(
    ("text", "line", "named", "expected"),
    [
        ("tilt_arcsec: 3\nheading_arcsek: 5\n", 2, "heading_arcsek", "did you mean 'heading_arcsec'?"),
        ("inputs:\n  star_bow: {rate: 2.0}\n", 2, "inputs.star_bow.rate", "did you mean 'rate_hz'?"),
        ("inputs:\n  inz: {rate_hz: 2.0}\n", 2, "inputs.inz", "did you mean 'ins'?"),
        ("inputs:\n  gnss_bow: {rate_hz: 2.0}\n", 2, "inputs.gnss_bow", "expected one of ins, star"),
        ("# ours\nheading_arcsec: 0\n", 2, "heading_arcsec", "[0.1, 360000.0]"),
        ("heading_arcsec: .nan\n", 1, "heading_arcsec", "must be finite"),
        ("alerts:\n  escalate_after_s: long\n", 2, "alerts.escalate_after_s", "must be"),
        ("alerts: 5\n", 1, "alerts", "must be a group"),
        ("", 1, "", "the file contains none"),
    ],
)
def test_error_is_reported_in_one_line(tmp_path: Path, text: str, line: int, named: str, expected: str) -> None:
    """The error contains file, line, key and the expected value, without a line break."""
    path = tmp_path / "ship.yaml"
    path.write_text(text)
    with pytest.raises(BadInput) as caught:
        read_limits(path)
    error = str(caught.value)
    assert str(path) in error
    assert f"line {line}" in error or f":{line}" in error
    assert named in error
    assert expected in error
    assert "\n" not in error


def test_sources_are_not_accepted_as_angles() -> None:
    """A kind of source is not an angle."""
    for kind in SOURCE_KINDS:
        with pytest.raises(KeyError):
            Limits().angle_limit(kind)


def test_documented_example_is_valid() -> None:
    """The example in docs/reference/limits.md is a valid file."""
    page = (Path(__file__).parents[3] / "docs/reference/limits.md").read_text(encoding="utf-8")
    shown = "\n".join(line[4:] for line in page.splitlines() if line.startswith("    "))
    limits = read_limits(shown)
    assert (limits.heading_arcsec, limits.input_limits("star.bow").rate_hz) == (8.0, 2.0)
    assert (limits.machine.disk_path, limits.machine.disk_free_gb) == ("/data", 50.0)
