"""Adapter of the node ``triangulation``: positions of a buoy from arriving directions, and rejected directions.

The true positions and directions are computed by pyerfa's own routines (ship_testing.theodolite_stations).
"""

from typing import Any

import numpy as np
import pytest

from ship_bags.message_factory import RosidlFactory
from ship_bags.stamps import make_header, ns_from_stamp
from ship_estimation.innovations.gates import mean_nees_band, normalized_error_squared
from ship_estimation.parameters.schema import ParameterError, build
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import ENU_FROM_HORIZON
from ship_geometry.rotations import ARCSEC, exp_rotation
from ship_node.adapters.adapter import Overload
from ship_testing.garbage import paths, put_garbage
from ship_testing.one_message import process_message
from ship_testing.theodolite_stations import FACTORY, buoy_direction, buoy_n, direction_message, triangulation_values
from theodolite_calib.adapters.triangulation_adapter import INNOVATION_TOPIC, POSITION_TOPIC, TriangulationAdapter
from theodolite_calib.triangulation.triangulation import TriangulationConfig
from theodolite_calib.triangulation.triangulation_core import MAX_TARGETS, MAX_WAITING

START_NS, PERIOD_NS, LATENCY_NS = 1_767_225_600_000_000_000, 100_000_000, 50_000_000
SIGMA = 3.0 * ARCSEC
SECOND_NS = 1_000_000_000


def adapter_of(count: int = 3, **changes: Any) -> TriangulationAdapter:
    return TriangulationAdapter(build(TriangulationConfig, {**triangulation_values(count), **changes}), FACTORY)


def buoy_message(number: int, time_ns: int, turn_n: Any = (0.0, 0.0, 0.0), **changes: Any) -> Any:
    """Return a theodolite's direction of the buoy, rotated by an error."""
    turned_n = exp_rotation(np.asarray(turn_n, dtype=float)) @ buoy_direction(number, (time_ns - START_NS) * 1e-9)
    return direction_message(time_ns, turned_n, SIGMA, **changes)


def give_message(adapter: TriangulationAdapter, number: int, message: Any, received_ns: int | None = None) -> list[Any]:
    """Pass a message of a theodolite to the adapter; return all that is published."""
    received_ns = ns_from_stamp(message.header.stamp) + LATENCY_NS if received_ns is None else received_ns
    return process_message(adapter, f"t{number}/theodolite/target_direction", message, received_ns)


def published_positions(published: list[Any]) -> list[Any]:
    return [message for topic, message in published if topic == POSITION_TOPIC]


def published_reasons(published: list[Any]) -> list[tuple[str, int]]:
    return [(message.source, message.reason) for topic, message in published if topic == INNOVATION_TOPIC]


def error_m(message: Any) -> np.ndarray:
    since_s = (ns_from_stamp(message.header.stamp) - START_NS) * 1e-9
    return ENU_FROM_HORIZON.T @ [message.position.x, message.position.y, message.position.z] - buoy_n(since_s)


def test_positions_match_their_covariance() -> None:
    adapter, rng, squares = adapter_of(), np.random.default_rng(3), []
    for index in range(120):
        time_ns = START_NS + index * PERIOD_NS
        found = [
            message
            for number in range(3)
            for message in published_positions(
                give_message(adapter, number, buoy_message(number, time_ns, SIGMA * rng.standard_normal(3)))
            )
        ]
        if index == 0:
            continue  # no theodolite has reported the buoy yet
        (message,) = found
        if message.status == Status.INVALID:
            continue  # one set of a thousand does not fit
        covariance = ENU_FROM_HORIZON.T @ message.position_covariance.reshape(3, 3) @ ENU_FROM_HORIZON
        squares.append(float(normalized_error_squared(error_m(message), covariance)))
        assert (message.status, message.target_id, message.header.frame_id) == (0, "buoy", "triangulation_origin")
        assert np.isnan([message.azimuth, message.elevation, message.direction.x]).all()
    assert len(squares) >= 117
    low, high = mean_nees_band(len(squares), 3)
    assert low < np.mean(squares) < high


def test_one_position_per_stamp_of_the_first_for_any_order_of_arrival() -> None:
    adapter, found = adapter_of(), []
    for number in range(3):
        found += published_positions(
            give_message(adapter, number, buoy_message(number, START_NS + 10_000_000 * number))
        )
    arrivals = [(START_NS + index * PERIOD_NS + 10_000_000 * n, n) for index in range(1, 12) for n in (0, 1, 2)]
    order = np.random.default_rng(4).permutation(len(arrivals)).reshape(-1, 3)
    for came, block in enumerate(np.sort(order.ravel()).reshape(-1, 3)):
        for place in np.random.default_rng(came).permutation(block):
            time_ns, number = arrivals[place]
            found += published_positions(
                give_message(adapter, number, buoy_message(number, time_ns), START_NS + (came + 2) * PERIOD_NS)
            )
    stamps = [ns_from_stamp(message.header.stamp) for message in found if message.status != Status.INVALID]
    assert stamps == sorted(set(stamps))
    assert [(stamp - START_NS) % PERIOD_NS for stamp in stamps] == [0] * len(stamps)
    assert len(stamps) == 11
    for message in found[-8:]:
        assert np.linalg.norm(error_m(message)) < 0.05


def test_overtaken_message_is_late_without_other_theodolites() -> None:
    adapter, published = adapter_of(2), []
    for number in range(2):
        give_message(adapter, number, buoy_message(number, START_NS))
    for number, index in ((1, 2), (0, 2), (0, 1)):
        published += give_message(
            adapter, number, buoy_message(number, START_NS + index * PERIOD_NS), START_NS + 3 * PERIOD_NS
        )
    assert [ns_from_stamp(message.header.stamp) for message in published_positions(published)] == [
        START_NS + 2 * PERIOD_NS
    ]
    assert published_reasons(published) == [("station.t0", Reason.LATE)]


def test_reporting_theodolite_is_awaited_up_to_the_lag() -> None:
    adapter = adapter_of(3, lag_s=0.5)
    for index in range(3):
        for number in range(3):
            give_message(adapter, number, buoy_message(number, START_NS + index * PERIOD_NS))
    time_ns = START_NS + 3 * PERIOD_NS
    assert published_positions(give_message(adapter, 0, buoy_message(0, time_ns))) == []
    assert published_positions(give_message(adapter, 1, buoy_message(1, time_ns))) == []
    now_ns = time_ns + LATENCY_NS
    assert published_positions(adapter.tick(now_ns + 400_000_000)) == []
    (place,) = published_positions(adapter.tick(now_ns + 600_000_000))
    assert place.status == Status.VALID
    # A theodolite without data for longer than the lag is no longer awaited.
    for index in range(4, 11):
        later_ns = time_ns + index * PERIOD_NS
        first, second = (
            published_positions(give_message(adapter, number, buoy_message(number, later_ns))) for number in (0, 1)
        )
    assert first == []
    assert [ns_from_stamp(place.header.stamp) for place in second] == [later_ns]
    # A direction that arrives after the position of its stamp is rejected.
    assert published_reasons(give_message(adapter, 2, buoy_message(2, time_ns), later_ns + LATENCY_NS)) == [
        ("station.t2", Reason.LATE)
    ]


def test_a_node_that_is_behind_reports_no_position_as_published() -> None:
    adapter = adapter_of(2)

    def positions(first: int, last: int) -> list[Any]:
        stamps_ns = range(START_NS + first * PERIOD_NS, START_NS + last * PERIOD_NS, PERIOD_NS)
        return [
            position
            for time_ns in stamps_ns
            for number in range(2)
            for position in published_positions(give_message(adapter, number, buoy_message(number, time_ns)))
        ]

    def status_text(index: int) -> str:
        (status,) = adapter.own_statuses(START_NS + index * PERIOD_NS)
        return status.message

    assert positions(0, 5)
    adapter.overload(Overload(3.2, 2, 12.0), START_NS + 5 * PERIOD_NS)
    assert positions(5, 123) == []
    assert status_text(123).startswith("no position for 12 s")
    adapter.overload(Overload(0.0, 2, 1.0), START_NS + 123 * PERIOD_NS)
    assert positions(123, 128)
    assert status_text(128).startswith("VALID: ")


def test_single_theodolite_is_invalid_with_the_reason() -> None:
    adapter = adapter_of(2)
    published = give_message(adapter, 0, buoy_message(0, START_NS))
    (place,) = published_positions(published)
    assert place.status == Status.INVALID
    assert np.isnan([place.position.x, place.position.y, place.position.z, *place.position_covariance]).all()
    assert published_reasons(published) == [("stations", Reason.GAP)]


def test_directions_that_do_not_fit_claim_nothing() -> None:
    adapter = adapter_of(3)
    for number in range(3):
        give_message(adapter, number, buoy_message(number, START_NS))
    published = []
    for number in range(3):
        turn_n = [0.0, 0.01, 0.0] if number == 1 else [0.0, 0.0, 0.0]
        published += give_message(adapter, number, buoy_message(number, START_NS + PERIOD_NS, turn_n))
    (place,) = published_positions(published)
    assert place.status == Status.INVALID
    assert np.isnan(place.position.x)
    assert published_reasons(published) == [("stations", Reason.GATE)]


@pytest.mark.parametrize("status", [Status.VALID, Status.COASTING, Status.DEGRADED])
def test_a_place_is_worth_no_more_than_the_directions_that_it_rests_on(status: Status) -> None:
    adapter, published = adapter_of(3), []
    for index in range(2):
        for number in range(3):
            worth = status if number == 1 else Status.VALID
            published += give_message(
                adapter, number, buoy_message(number, START_NS + index * PERIOD_NS, status=int(worth))
            )
    assert published_positions(published)[-1].status == status


def test_invalid_direction_is_ignored_and_not_awaited() -> None:
    adapter, published = adapter_of(3), []
    for index in range(2):
        for number in range(3):
            changes = {"status": int(Status.INVALID)} if index and number == 2 else {}
            published = give_message(adapter, number, buoy_message(number, START_NS + index * PERIOD_NS, **changes))
    (place,) = published_positions(published)
    assert place.status == Status.VALID
    assert (("station.t2", Reason.GAP)) in published_reasons(published)


def test_contradictory_theodolite_is_degraded() -> None:
    adapter, published = adapter_of(2), []
    for index in range(3):
        time_ns = START_NS + index * PERIOD_NS
        give_message(adapter, 0, buoy_message(0, time_ns))
        if index == 1:
            published += give_message(adapter, 0, buoy_message(0, time_ns, [0.0, 1e-6, 0.0]))
        published += give_message(adapter, 1, buoy_message(1, time_ns))
    assert ("station.t0", Reason.CONFLICT) in published_reasons(published)
    assert [place.status for place in published_positions(published)][-1] == Status.DEGRADED
    statuses = {status.name: status for status in adapter.own_statuses(START_NS + 4 * PERIOD_NS)}
    assert "station.t0 sent conflicting data with one stamp" in statuses["position"].message


def test_a_place_by_directions_of_two_publishers_is_degraded_while_both_send() -> None:
    adapter, published = adapter_of(2), []
    topic, text = next(iter(adapter.feeds)), "two publishers send on it: /a and /b; end all but one"
    for index in range(6):
        adapter.set_duplicate_publishers(topic, text if index in (2, 3) else "")
        for number in range(2):
            published += give_message(adapter, number, buoy_message(number, START_NS + index * PERIOD_NS))
    statuses = [place.status for place in published_positions(published)]
    # For the first direction there is no direction of the other theodolite yet.
    assert statuses[1:] == [Status.VALID, Status.DEGRADED, Status.DEGRADED, Status.VALID, Status.VALID]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"direction": FACTORY.make("geometry_msgs/msg/Vector3", x=90.0, y=1.0, z=0.0)}, Reason.UNITS),
        ({"direction": FACTORY.make("geometry_msgs/msg/Vector3", x=np.nan, y=1.0, z=0.0)}, Reason.NON_FINITE),
        ({"direction_covariance": np.zeros(9)}, Reason.BAD_COVARIANCE),
        ({"direction_covariance": np.full(9, np.nan)}, Reason.NON_FINITE),
        ({"direction_covariance": -np.eye(3).ravel() * 2.0}, Reason.BAD_COVARIANCE),
        ({"direction_covariance": np.diag([0.0, 0.0, SIGMA**2]).ravel()}, Reason.BAD_COVARIANCE),
        ({"status": 7}, Reason.UNITS),
        ({"header": make_header(FACTORY, START_NS, "triangulation_origin")}, Reason.FRAME),
        ({"header": make_header(FACTORY, START_NS + 10 * SECOND_NS, "horizon")}, Reason.FUTURE),
        ({"header": make_header(FACTORY, 0, "horizon")}, Reason.BAD_STAMP),
    ],
)
def test_unusable_messages_are_rejected_with_the_reason(changes: dict, reason: Reason) -> None:
    adapter = adapter_of(2)
    published = give_message(adapter, 0, buoy_message(0, START_NS, **changes), START_NS + LATENCY_NS)
    assert published_reasons(published) == [("station.t0", reason)]
    assert published_positions(published) == []


def test_a_dropped_target_has_its_directions_answered_and_increasing_stamps() -> None:
    adapter, published = adapter_of(2), []
    for index in range(2):
        for number in (1, 0) if index else (0, 1):
            published += give_message(adapter, number, buoy_message(number, START_NS + index * PERIOD_NS))
    waiting_ns = START_NS + 2 * PERIOD_NS
    assert published_positions(give_message(adapter, 0, buoy_message(0, waiting_ns))) == []
    published = []
    for index in range(MAX_TARGETS):
        published += give_message(adapter, 1, buoy_message(1, waiting_ns, target_id=f"x{index}"))
    (answer,) = [message for message in published_positions(published) if message.target_id == "buoy"]
    assert (ns_from_stamp(answer.header.stamp), answer.status) == (waiting_ns, Status.INVALID)
    assert ("stations", Reason.OVERFLOW) in published_reasons(published)
    # From new directions, the target gets no position at or before the stamp of its last answer.
    published = []
    for index in range(1, 4):
        for number in (1, 0):
            published += give_message(
                adapter, number, buoy_message(number, START_NS + index * PERIOD_NS), START_NS + 4 * PERIOD_NS
            )
    assert published_reasons(published)[:4] == [(f"station.t{number}", Reason.LATE) for number in (1, 0, 1, 0)]
    stamps = [ns_from_stamp(message.header.stamp) for message in published_positions(published)]
    assert stamps
    assert min(stamps) > waiting_ns


@pytest.mark.parametrize("invalid_comes_first", [True, False])
def test_nothing_is_interpolated_across_an_invalid_direction(invalid_comes_first: bool) -> None:
    adapter, found = adapter_of(2), []
    arrivals = [(index, number) for index in range(11) for number in (0, 1)]
    if invalid_comes_first:
        # All reports of the second theodolite arrive before those of the first for the same times.
        arrivals = sorted(arrivals, key=lambda arrival: (arrival[0] > 2, arrival[0] > 2 and arrival[1] == 0, arrival))
    for index, number in arrivals:
        worth = Status.INVALID if number == 1 and 3 <= index < 10 else Status.VALID
        message = buoy_message(number, START_NS + index * PERIOD_NS + 10_000_000 * number, status=int(worth))
        found += published_positions(give_message(adapter, number, message, START_NS + 11 * PERIOD_NS))
    since = {ns_from_stamp(message.header.stamp) - START_NS: message.status for message in found}
    statuses = [since[index * PERIOD_NS] for index in range(1, 11)]
    # At 0.3 s the next direction of the second theodolite is INVALID, at 1.0 s the last one.
    assert statuses == [Status.VALID] * 2 + [Status.INVALID] * 8


@pytest.mark.parametrize("invalid_comes_first", [True, False])
def test_valid_and_invalid_at_one_stamp_are_a_conflict_and_invalid_counts(invalid_comes_first: bool) -> None:
    adapter, published = adapter_of(3), []
    for index in range(2):
        for number in range(3):
            give_message(adapter, number, buoy_message(number, START_NS + index * PERIOD_NS))
    time_ns = START_NS + 2 * PERIOD_NS
    pair = [buoy_message(0, time_ns), buoy_message(0, time_ns, status=int(Status.INVALID))]
    for message in reversed(pair) if invalid_comes_first else pair:
        published += give_message(adapter, 0, message)
    for number in (1, 2):
        published += give_message(adapter, number, buoy_message(number, time_ns))
    assert ("station.t0", Reason.CONFLICT) in published_reasons(published)
    (place,) = published_positions(published)
    assert adapter.latest.stations == ("t1", "t2")
    assert place.status == Status.VALID


def test_no_flood_of_names_or_directions_grows_without_bound() -> None:
    adapter = adapter_of(2, lag_s=60.0)
    for index in range(3 * MAX_TARGETS):
        give_message(adapter, 0, buoy_message(0, START_NS, target_id=f"buoy {index}"), START_NS + LATENCY_NS)
    assert len(adapter.core._targets) == MAX_TARGETS
    adapter.service("reset", START_NS)
    give_message(adapter, 1, buoy_message(1, START_NS), START_NS + LATENCY_NS)
    published = []
    for index in range(1, MAX_WAITING + 50):
        published += give_message(adapter, 0, buoy_message(0, START_NS + index * 1_000_000), START_NS + 2 * SECOND_NS)
    assert len(adapter.core._targets["buoy"].waiting) == MAX_WAITING
    assert len(published_positions(published)) == 49


def test_no_message_whatsoever_raises_or_does_damage() -> None:
    rng, adapter = np.random.default_rng(4713), adapter_of(3)
    fields, found, now_ns = paths(buoy_message(0, START_NS, factory=RosidlFactory())), set(), START_NS
    for index in range(300):
        now_ns = START_NS + index * PERIOD_NS + LATENCY_NS
        for number in range(3):
            time_ns = START_NS + index * PERIOD_NS
            published = give_message(adapter, number, buoy_message(number, time_ns), now_ns)
            for _ in range(3):
                bad = buoy_message(number, time_ns, factory=RosidlFactory())
                put_garbage(bad, fields, rng)
                published += give_message(adapter, number, bad, now_ns)
            found |= {reason for _, reason in published_reasons(published)}
            for message in published_positions(published):
                numbers = [message.position.x, message.position.y, message.position.z, *message.position_covariance]
                assert np.isnan(numbers).all() == (message.status == Status.INVALID)
                assert np.isfinite(numbers).all() != (message.status == Status.INVALID)
        adapter.tick(now_ns)
    assert found >= {Reason.NON_FINITE, Reason.BAD_COVARIANCE, Reason.UNITS, Reason.FRAME, Reason.BAD_STAMP}
    assert found >= {Reason.FUTURE, Reason.LATE, Reason.CONFLICT, Reason.GAP, Reason.GATE}
    assert Reason.FAILED not in found
    assert adapter.health.messages(FACTORY, now_ns)
    adapter.service("reset", now_ns)
    later_ns = START_NS + 1000 * PERIOD_NS
    published = []
    for index in range(2):
        for number in range(3):
            published += give_message(adapter, number, buoy_message(number, later_ns + index * PERIOD_NS))
    assert published_positions(published)[-1].status == Status.VALID
    assert np.linalg.norm(error_m(published_positions(published)[-1])) < 0.05


def test_sources_off_gate_and_reset_by_live_means() -> None:
    adapter = adapter_of(3)
    adapter.set_parameters({"sources_off": ("station.t1",)})
    published = []
    for index in range(2):
        for number in range(3):
            turn_n = [0.0, 0.01, 0.0] if number == 1 else [0.0, 0.0, 0.0]
            published += give_message(adapter, number, buoy_message(number, START_NS + index * PERIOD_NS, turn_n))
    assert ("station.t1", Reason.OFF) in published_reasons(published)
    assert published_positions(published)[-1].status == Status.VALID
    adapter.set_parameters({"refraction.coefficient": 0.5, "refraction.sigma": 0.2})
    assert adapter.core.config.refraction.sigma == 0.2
    with pytest.raises(ParameterError, match=r"there is no source 'station\.t9'"):
        adapter.set_parameters({"sources_off": ("station.t9",)})
    assert adapter.service("reset", START_NS).success
    assert adapter.core._targets == {}


def test_diagnostics_report_the_last_position() -> None:
    adapter = adapter_of(2)
    (status,) = adapter.own_statuses(START_NS)
    assert status.message == "no position yet"
    published = []
    for index in range(2):
        for number in range(2):
            published += give_message(adapter, number, buoy_message(number, START_NS + index * PERIOD_NS))
    (status,) = adapter.own_statuses(START_NS + SECOND_NS)
    assert status.message == "VALID: by t0, t1"
    sigma_m = np.sqrt(np.sum(published_positions(published)[-1].position_covariance[::4]))
    assert float(status.values["sigma in space (m)"]) == pytest.approx(sigma_m, rel=0.01)
    (status,) = adapter.own_statuses(START_NS + 20 * SECOND_NS)
    assert status.message == "no position for 20 s, the last VALID"


@pytest.mark.parametrize(
    ("topics", "named"),
    [
        (["a/target_direction", "a/target_direction"], "is already used by 't0'"),
        (["/west/theodolite/target_direction", ""], "expected a relative name"),
        (["west target", ""], "expected a relative name"),
    ],
)
def test_topics_that_cannot_be_are_named(topics: list[str], named: str) -> None:
    values = triangulation_values(2)
    for number, topic in enumerate(topics):
        values["stations"][f"t{number}"]["topic"] = topic
    with pytest.raises(ParameterError, match=named):
        build(TriangulationConfig, values)


def test_fewer_than_two_theodolites_are_warned_of() -> None:
    assert adapter_of(2).start_warnings == ()
    assert adapter_of(1).start_warnings == ("stations has 1: a position needs two theodolites or more",)
