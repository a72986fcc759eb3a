"""The text of an input error is composed of its attributes."""

import pytest

from ship_geometry.input_error import InputError


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ({}, "is too long"),
        ({"file": "suite.yaml"}, "suite.yaml: is too long"),
        ({"file": "suite.yaml", "line": 3}, "suite.yaml:3: is too long"),
    ],
)
def test_the_text_names_file_and_line_before_the_reason(place, text):
    problem = InputError("is too long", **place, parameters=("sensors.fore",), value=7)
    assert str(problem) == text
    assert (problem.reason, problem.parameters, problem.value) == ("is too long", ("sensors.fore",), 7)
