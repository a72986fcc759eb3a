"""Configuration dataclasses: build, describe, refuse and change while running."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from ship_estimation.parameters.fields import mapping_of, parameter, section
from ship_estimation.parameters.schema import ParameterError, build, describe, flatten, nest, with_changes


@dataclass(frozen=True)
class Sensor:
    """One sensor of the mapping."""

    azimuth_deg: float = parameter(doc="azimuth", unit="deg", minimum=-360.0, maximum=360.0)
    sigma_arcsec: float = parameter(3.0, doc="white noise", unit="arcsec", minimum=0.0, live=True)


@dataclass(frozen=True)
class Gate:
    """A section."""

    probability: float = parameter(0.999, doc="gate", minimum=0.5, maximum=1.0, live=True)
    reopen_after: int = parameter(0, doc="refusals", minimum=0, maximum=1000)


@dataclass(frozen=True)
class Config:
    """The whole."""

    frame_id: str = parameter(doc="name of the frame")
    convention: str = parameter("enu_flu", doc="axes", choices=("enu_flu", "ned_frd"))
    enabled: bool = parameter(True, doc="on or off")
    lever_m: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0), doc="lever", unit="m", minimum=-500.0, maximum=500.0
    )
    topics: tuple[str, ...] = parameter((), doc="topics")
    gate: Gate = section(Gate)
    star_sensors: dict[str, Sensor] = mapping_of("star sensors by id")


VALUES: dict[str, Any] = {
    "frame_id": "ins",
    "lever_m": [1, 2.5, -3.0],
    "gate": {"reopen_after": 7},
    "star_sensors": {"fore": {"azimuth_deg": 0}, "abeam": {"azimuth_deg": 90.0, "sigma_arcsec": 5.0}},
}


def test_build_fills_defaults_and_turns_whole_numbers_into_floats() -> None:
    config = build(Config, VALUES)
    assert config == Config(
        frame_id="ins",
        convention="enu_flu",
        enabled=True,
        lever_m=(1.0, 2.5, -3.0),
        topics=(),
        gate=Gate(0.999, 7),
        star_sensors={"abeam": Sensor(90.0, 5.0), "fore": Sensor(0.0, 3.0)},
    )
    assert type(config.star_sensors["fore"].azimuth_deg) is float
    assert list(config.star_sensors) == ["abeam", "fore"]  # independent of the order in the file


def test_arrays_of_a_ros_node_are_lists() -> None:
    config = build(Config, {"frame_id": "ins", "lever_m": np.array([1.0, 2.0, 3.0]), "topics": ["a", "b"]})
    assert config.lever_m == (1.0, 2.0, 3.0)
    assert config.topics == ("a", "b")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"colour": 1}, r"'colour' is unknown: expected one of convention, enabled, frame_id, gate, lever_m"),
        ({"gate": {"probabilty": 0.9}}, r"'gate\.probabilty' is unknown: expected one of probability, reopen_after"),
        ({"star_sensors": {"fore": {"azimuth_deg": 0.0, "x": 1}}}, r"'star_sensors\.fore\.x' is unknown"),
        ({"star_sensors": {"fore": {}}}, r"'star_sensors\.fore\.azimuth_deg' \(azimuth\) must be given"),
        ({"star_sensors": {"fore": 3.0}}, r"'star_sensors\.fore' must be a group of parameters, got 3\.0"),
        ({"star_sensors": [1, 2]}, r"'star_sensors' must be a group of parameters"),
        ({"gate": None}, r"'gate' must be a group of parameters, got None"),
        ({"gate": {"probability": "0.9"}}, r"'gate\.probability' must be of type float, got '0\.9'"),
        ({"gate": {"probability": True}}, r"'gate\.probability' must be of type float, got True"),
        ({"gate": {"probability": None}}, r"'gate\.probability' must be of type float, got None"),
        ({"gate": {"reopen_after": 2.0}}, r"'gate\.reopen_after' must be of type int, got 2\.0"),
        ({"gate": {"reopen_after": False}}, r"'gate\.reopen_after' must be of type int, got False"),
        ({"enabled": 1}, r"'enabled' must be of type bool, got 1"),
        ({"frame_id": 5}, r"'frame_id' must be of type str, got 5"),
        ({"gate": {"probability": float("nan")}}, r"'gate\.probability' must be finite, got nan"),
        (
            {"star_sensors": {"a": {"azimuth_deg": float("inf")}}},
            r"'star_sensors\.a\.azimuth_deg' must be finite, got inf",
        ),
        ({"gate": {"probability": 0.4}}, r"'gate\.probability' = 0\.4 is out of its range \[0\.5, 1\.0\]"),
        ({"gate": {"reopen_after": 1001}}, r"'gate\.reopen_after' = 1001 is out of its range \[0, 1000\]"),
        (
            {"star_sensors": {"a": {"azimuth_deg": 0.0, "sigma_arcsec": -3.0}}},
            r"'star_sensors\.a\.sigma_arcsec' = -3\.0 arcsec is out of its range \[0\.0, inf\] arcsec",
        ),
        ({"convention": "nwu"}, r"'convention' = 'nwu' must be one of enu_flu, ned_frd"),
        ({"lever_m": [1.0, 2.0]}, r"'lever_m' must have 3 elements, got 2"),
        ({"lever_m": 1.0}, r"'lever_m' must be a list, got 1\.0"),
        ({"lever_m": []}, r"'lever_m' must have 3 elements, got 0"),
        ({"lever_m": "123"}, r"'lever_m' must be a list, got '123'"),
        ({"lever_m": [1.0, float("nan"), 0.0]}, r"'lever_m\[1\]' must be finite"),
        ({"lever_m": [1.0, 0.0, 501.0]}, r"'lever_m\[2\]' = 501\.0 m is out of its range \[-500\.0, 500\.0\] m"),
        ({"topics": ["a", 1]}, r"'topics\[1\]' must be of type str, got 1"),
    ],
)
def test_refusal_names_parameter_value_and_what_is_allowed(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        build(Config, {**VALUES, **changes})


def test_what_has_no_default_must_be_given() -> None:
    with pytest.raises(ParameterError, match=r"'frame_id' \(name of the frame\) must be given"):
        build(Config, {})


@pytest.mark.parametrize("probability", [0.5, 1.0])
def test_ends_of_a_range_are_inside(probability: float) -> None:
    assert build(Config, {**VALUES, "gate": {"probability": probability}}).gate.probability == probability


def test_describe_names_every_parameter_in_order_of_declaration() -> None:
    described = list(describe(Config))
    assert [d.name for d in described] == [
        "frame_id",
        "convention",
        "enabled",
        "lever_m",
        "topics",
        "gate.probability",
        "gate.reopen_after",
        "star_sensors.<id>.azimuth_deg",
        "star_sensors.<id>.sigma_arcsec",
    ]
    sigma = described[-1]
    assert (sigma.kind, sigma.default, sigma.unit, sigma.doc) == (float, 3.0, "arcsec", "white noise")
    assert (sigma.minimum, sigma.maximum, sigma.choices, sigma.live) == (0.0, None, (), True)
    assert described[0].default is None
    assert described[1].choices == ("enu_flu", "ned_frd")


def test_flatten_and_nest_undo_one_another() -> None:
    config = build(Config, VALUES)
    flat = flatten(config)
    assert flat["star_sensors.abeam.sigma_arcsec"] == 5.0
    assert flat["lever_m"] == [1.0, 2.5, -3.0]
    assert build(Config, nest(flat)) == config
    assert nest({"a.b.c": 1, "a.d": 2, "e": 3}) == {"a": {"b": {"c": 1}, "d": 2}, "e": 3}


def test_value_is_no_group() -> None:
    with pytest.raises(ParameterError, match="'gate' is a value, not a group"):
        nest({"gate": 1.0, "gate.probability": 0.9})


def test_live_parameters_change_and_the_rest_stays() -> None:
    config = build(Config, VALUES)
    after = with_changes(config, {"star_sensors.fore.sigma_arcsec": 4, "gate.probability": 0.99})
    fore = Sensor(0.0, 4.0)
    expected = dataclasses.replace(
        config, gate=Gate(0.99, 7), star_sensors={"abeam": config.star_sensors["abeam"], "fore": fore}
    )
    assert after == expected
    assert config == build(Config, VALUES)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"star_sensors.fore.azimuth_deg": 1.0}, r"azimuth_deg' cannot be changed while the node runs"),
        ({"frame_id": "x"}, r"'frame_id' cannot be changed while the node runs"),
        ({"star_sensors.aft.sigma_arcsec": 1.0}, r"'star_sensors\.aft\.sigma_arcsec' is unknown"),
        ({"gate": 1.0}, r"'gate' is unknown"),
        ({"gate.probability": 2.0}, r"'gate\.probability' = 2\.0 is out of its range"),
        ({"gate.probability": float("nan")}, r"'gate\.probability' must be finite"),
    ],
)
def test_refused_changes(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        with_changes(build(Config, VALUES), changes)


def test_parameter_may_be_named_like_a_python_keyword() -> None:
    @dataclass(frozen=True)
    class Source:
        from_: tuple[str, ...] = parameter((), doc="addresses", live=True)

    config = build(Source, {"from": ["10.0.0.7"]})
    assert config.from_ == ("10.0.0.7",)
    assert flatten(config) == {"from": ["10.0.0.7"]}
    assert [one.name for one in describe(Source)] == ["from"]
    assert with_changes(config, {"from": []}).from_ == ()
    with pytest.raises(ParameterError, match="'from_' is unknown"):
        build(Source, {"from_": []})
