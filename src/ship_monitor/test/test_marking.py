"""Assignment of published names to a marked source."""

import pytest

from ship_monitor.plots.figures import belongs_to_source, is_budget_part_of, is_event_of_source
from ship_watch.suite_state import Event

# As ship/error_budget and theodolite/error_budget of a ship with everything aboard name them.
SHIP = (
    *("ins_drift", "ins_noise", "ins_time_offset", "installation", "star_common", "refraction", "earth_rotation"),
    *("ship_position", "reference_installation", "reference_time_offset", "interpolation", "star_noise"),
    *("reference_noise", "saved_alignment"),
)
POINTING = (
    *("ship_attitude", "deformation", "axis_errors", "focal_length", "parallelism", "rtk", "lever_arms"),
    *("principal_point", "refraction", "drone_attitude", "ship_noise", "encoder", "image", "saved_calibration"),
)


@pytest.mark.parametrize(
    ("source", "parts"),
    [
        ("ins", {"ins_drift", "ins_noise", "ins_time_offset", "interpolation"}),
        ("star.bow", {"installation", "star_common", "star_noise"}),
        ("reference.gyro", {"reference_installation", "reference_time_offset", "reference_noise"}),
        ("lights", {"image"}),
        ("encoder", {"encoder"}),
        ("baselines", {"rtk", "lever_arms", "drone_attitude"}),
        ("ship_attitude", {"ship_attitude", "ship_noise"}),
        ("gnss", {"ship_position"}),
        ("weather", {"refraction"}),
        ("", set()),
        ("unknown.source", set()),
    ],
)
def test_budget_parts_of_a_source(source, parts):
    assert {part for part in SHIP + POINTING if is_budget_part_of(part, source)} == parts


@pytest.mark.parametrize(
    ("name", "source", "belongs"),
    [
        ("star.bow.azimuth", "star.bow", True),
        ("star.bow", "star.bow", True),
        ("star.bow_2.azimuth", "star.bow", False),
        ("ins.time_offset", "ins", True),
        ("installation", "ins", False),
        ("light.a", "lights", True),
        ("beta_x", "baselines", False),
        ("star.bow.azimuth", "", False),
    ],
)
def test_states_belong_to_the_source_in_their_name(name, source, belongs):
    assert belongs_to_source(name, source) is belongs


@pytest.mark.parametrize(
    ("subject", "text", "source", "belongs"),
    [
        ("star.bow", "star.bow OUT, no data", "star.bow", True),
        ("heading", "heading SAFE → CAUTION, star.bow out", "star.bow", True),
        ("heading", "heading SAFE → CAUTION, star.bow.left out", "star.bow", False),
        ("heading", "WARNING star.bow.", "star.bow", True),
        ("ship/attitude", "ship/attitude VALID → DEGRADED", "ins", False),
        ("theodolite/pointing", "pointing by encoder → 2 lights", "encoder", True),
        ("theodolite/pointing", "within limits", "ins", False),
        ("heading", "heading SAFE", "", False),
    ],
)
def test_events_of_a_source_by_subject_or_text(subject, text, source, belongs):
    assert is_event_of_source(Event(0, "state", subject, text), source) is belongs
