"""Unusable messages of stars on the mount: rejection, its name, and its effect on the rest."""

import copy
from typing import Any

import pytest

from ship_bags.stamps import make_header
from ship_estimation.rejection_rules import Reason
from ship_testing.adapter_runs import FACTORY, START_NS
from ship_testing.mount_stars import CAMERA, MOUNTED_DEG
from ship_testing.one_message import process_message
from ship_testing.small_session import config
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter

STARS, INNOVATION = "theodolite/night/stars", "theodolite/innovation"
VEGA, ALTAIR = 91262, 97649


@pytest.fixture(scope="module", name="adapter")
def _adapter() -> OpticalAxisAdapter:
    own = {f"telescopes__night__camera__{name}": value for name, value in CAMERA.items()}
    own |= {f"telescopes__night__{name}": value for name, value in MOUNTED_DEG.items()}
    return OpticalAxisAdapter(config(**own, telescopes__night__frame_id="night"), FACTORY)


def star(catalogue_id: int, u: float, v: float) -> Any:
    unknown = float("nan")
    return FACTORY.make(
        "ship_msgs/msg/StarObservation",
        catalogue_id=catalogue_id,
        right_ascension=unknown,
        declination=unknown,
        u=u,
        v=v,
        sigma_px=0.1,
        magnitude=unknown,
    )


def star_message(time_ns: int = START_NS) -> Any:
    return FACTORY.make(
        "ship_msgs/msg/StarObservationArray",
        header=make_header(FACTORY, time_ns, "night"),
        sensor_id="night",
        exposure_s=0.02,
        stars=[star(VEGA, 1000.0, 1200.0), star(ALTAIR, 1300.0, 900.0)],
    )


def reported_reasons(adapter: OpticalAxisAdapter, message: Any) -> list[Any]:
    published = process_message(adapter, STARS, message, START_NS + 50_000_000)
    return [one for topic, one in published if topic == INNOVATION]


@pytest.mark.parametrize(
    ("path", "value", "reason", "text"),
    [
        (("sensor_id",), "aft", Reason.UNKNOWN_SENSOR, "'aft'"),
        (("header", "frame_id"), "main", Reason.FRAME, "'main'"),
        (("exposure_s",), -1.0, Reason.UNITS, "exposure_s"),
        (("header", "stamp", "sec"), 0, Reason.BAD_STAMP, ""),
    ],
)
def test_unreadable_exposure_is_rejected(adapter, path, value, reason: Reason, text: str) -> None:
    message = star_message()
    *ways, leaf = path
    target = message
    for way in ways:
        target = getattr(target, way)
    setattr(target, leaf, value)
    (rejected,) = reported_reasons(adapter, message)
    assert (rejected.source, rejected.accepted, rejected.reason) == ("star.night", False, reason)
    assert text in rejected.reason_text


def test_a_star_that_cannot_be_read_is_left_out_by_its_place_in_the_message(adapter) -> None:
    message = star_message(START_NS + 10_000_000)
    message.stars[0].u = float("nan")
    message.stars[1].catalogue_id = 99_999_999
    texts = [(one.source, one.reason, one.reason_text) for one in reported_reasons(adapter, message)]
    assert [(source, reason) for source, reason, _ in texts] == [
        ("star.night", Reason.NON_FINITE),
        ("star.night", Reason.UNKNOWN_STAR),
    ]
    assert [text.partition(":")[0] for _, _, text in texts] == ["star 1 of the message", "star 2 of the message"]


def test_second_exposure_of_one_stamp_is_a_conflict(adapter) -> None:
    first = star_message(START_NS + 20_000_000)
    second = copy.deepcopy(first)
    second.stars[0].u += 3.0
    assert reported_reasons(adapter, first) == []
    (conflict,) = reported_reasons(adapter, second)
    assert conflict.reason == Reason.CONFLICT
    (again,) = reported_reasons(adapter, copy.deepcopy(first))
    assert again.reason in (Reason.DUPLICATE, Reason.CONFLICT)


def test_unconfigured_camera_has_no_topic(adapter) -> None:
    topics = {topic.topic for topic in adapter.inputs}
    assert {STARS, "gnss/fix", "met/pressure", "met/temperature", "met/humidity"} <= topics
    assert not any(topic.required for topic in adapter.inputs if topic.topic in (STARS, "gnss/fix"))
    without = OpticalAxisAdapter(config(), FACTORY)
    assert not {topic.topic for topic in without.inputs} & {STARS, "gnss/fix"}
