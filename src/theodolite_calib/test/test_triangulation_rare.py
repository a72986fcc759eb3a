"""Directions with intervals longer than ``lag_s``: the node gives the positions of the command, and no others.

The true positions and directions are computed by pyerfa's own routines (ship_testing.theodolite_stations).
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ship_estimation.innovations.gates import normalized_error_squared
from ship_estimation.parameters.schema import build
from ship_estimation.time_order.outcome import Status
from ship_geometry.frames import ENU_FROM_HORIZON, horizon_covariance
from ship_geometry.rotations import ARCSEC
from ship_testing.adapter_runs import (
    FACTORY,
    AdapterRun,
    Arrival,
    changed_copy,
    exact_value,
    hand_over,
    sort_by_arrival,
    stamp_of,
)
from ship_testing.theodolite_stations import buoy_direction, buoy_n, direction_message, triangulation_values
from theodolite_calib.adapters.triangulation_adapter import POSITION_TOPIC, TriangulationAdapter
from theodolite_calib.commands.triangulate import target_positions
from theodolite_calib.messages.input_messages import direction
from theodolite_calib.triangulation.triangulation import TriangulatedPosition, TriangulationConfig
from theodolite_calib.triangulation.triangulation_core import MAX_TARGETS, StationDirections

SECOND_NS = 1_000_000_000
START_NS, LATENCY_NS = 1_767_225_600 * SECOND_NS, 50_000_000
SIGMA = 3.0 * ARCSEC
COUNT, PERIOD_S = 20, 5.0


def config_of(stations: int, **changes: Any) -> TriangulationConfig:
    return build(TriangulationConfig, {**triangulation_values(stations), **changes})


def arrivals(number: int, since_s: Any) -> list[Arrival]:
    """Return directions of one theodolite to the buoy at some times after the start."""
    found = []
    for at_s in since_s:
        time_ns = START_NS + round(at_s * SECOND_NS)
        message = direction_message(time_ns, buoy_direction(number, at_s), SIGMA)
        found.append(Arrival(f"t{number}/theodolite/target_direction", message, time_ns + LATENCY_NS))
    return found


def periodic_times(period_s: float, phase_s: float = 0.0) -> np.ndarray:
    return phase_s + np.arange(0.0, COUNT * PERIOD_S, period_s)


def run_of(config: TriangulationConfig, *of_stations: list[Arrival]) -> AdapterRun:
    run = AdapterRun(TriangulationAdapter(config, FACTORY))
    everything = sort_by_arrival(arrival for of_station in of_stations for arrival in of_station)
    hand_over(run, everything, until_ns=everything[-1].receive_ns + 20 * SECOND_NS)
    return run


def positions_by_stamp(run: AdapterRun) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return stamp → position (North, Up, East), m, and its covariance, m², for all messages that are not INVALID."""
    found = {}
    for message in run.messages(POSITION_TOPIC):
        if message.status != Status.INVALID:
            place_n = ENU_FROM_HORIZON.T @ [message.position.x, message.position.y, message.position.z]
            found[stamp_of(message)] = place_n, horizon_covariance(message.position_covariance.reshape(3, 3))
    return found


def waited_s(run: AdapterRun) -> dict[int, float]:
    """Return stamp → time from the stamp to the answer, s."""
    return {
        stamp_of(message): (published_ns - stamp_of(message)) / SECOND_NS
        for published_ns, topic, message in run.published
        if topic == POSITION_TOPIC
    }


def command_positions(config: TriangulationConfig, *of_stations: list[Arrival]) -> dict[int, np.ndarray]:
    recorded = []
    for number, of_station in enumerate(of_stations):
        seen = StationDirections(config.stations[f"t{number}"].station(f"t{number}"), config.max_gap_s)
        for arrival in of_station:
            seen.track.insert(direction(arrival.message, f"t{number}", arrival.receive_ns).value)
        recorded.append(seen)
    return {
        one.time_ns: one.position.position_n
        for one in target_positions(config, recorded)
        if isinstance(one.position, TriangulatedPosition)
    }


@pytest.mark.parametrize(
    ("phase_s", "max_gap_s", "missing"),
    [
        (0.0, 1.0, 1),  # same stamps: the first direction is answered before the other theodolite's first report
        (2.5, 8.0, 0),
        (4.9, 8.0, 0),
    ],
)
def test_rare_directions_give_the_places_of_the_command(phase_s: float, max_gap_s: float, missing: int) -> None:
    config = config_of(2, max_gap_s=max_gap_s)
    of_stations = [arrivals(0, periodic_times(PERIOD_S)), arrivals(1, periodic_times(PERIOD_S, phase_s))]
    expected, found = command_positions(config, *of_stations), positions_by_stamp(run_of(config, *of_stations))
    assert len(expected) >= COUNT - 1
    assert list(found) == sorted(expected)[missing:]
    for time_ns, (place_n, covariance_n) in found.items():
        true_n = buoy_n((time_ns - START_NS) / SECOND_NS)
        # The command interpolates with a later sample too, and no direction has noise.
        for other_n in (expected[time_ns], true_n):
            assert normalized_error_squared(place_n - other_n, covariance_n) < 1.0
        if phase_s == 0.0:
            np.testing.assert_allclose(place_n, expected[time_ns], atol=1e-6)


def test_places_at_a_common_rate_do_not_wait_for_a_theodolite_whose_next_report_cannot_be_joined() -> None:
    often = [arrivals(number, np.arange(0.0, 20.0, 0.1)) for number in (0, 1)]
    run = run_of(config_of(3), *often, arrivals(2, periodic_times(PERIOD_S, 0.05)))
    since_s = {round((time_ns - START_NS) / SECOND_NS % PERIOD_S, 3): age for time_ns, age in waited_s(run).items()}
    # The third theodolite reports every 5 s; the others are combined with its reports over at most max_gap_s, 1 s.
    assert all(age < 0.2 for phase_s, age in since_s.items() if 0.1 < phase_s < 4.0)
    assert all(age < 1.3 for age in since_s.values())


@pytest.mark.parametrize("interval_s", [0.1, 5.0])
def test_theodolite_without_data_is_awaited_until_overdue(interval_s: float) -> None:
    config = config_of(3, max_gap_s=8.0)
    of_two = [arrivals(number, periodic_times(interval_s)[:100]) for number in (0, 1)]
    run = run_of(config, *of_two, arrivals(2, periodic_times(interval_s)[:10]))
    last_ns = START_NS + round(9 * interval_s * SECOND_NS) + LATENCY_NS
    overdue_ns = last_ns + round((interval_s + config.lag_s) * SECOND_NS)
    published = [
        (published_ns, message)
        for published_ns, topic, message in run.published
        if topic == POSITION_TOPIC and stamp_of(message) > last_ns
    ]
    assert len(published) >= 10
    for published_ns, message in published:
        assert message.status == Status.VALID
        # Ticks come each tenth of a second.
        assert published_ns <= max(overdue_ns + 200_000_000, stamp_of(message) + LATENCY_NS)


def test_a_clock_that_lags_behind_holds_no_place_for_ever() -> None:
    config = config_of(3)
    behind = [
        Arrival(arrival.topic, arrival.message, arrival.receive_ns + 60 * SECOND_NS)
        for arrival in arrivals(2, np.arange(-59.0, 20.0, 1.0))
    ]
    run = run_of(config, *(arrivals(number, np.arange(0.0, 20.0, 0.5)) for number in (0, 1)), behind)
    assert max(waited_s(run).values()) < config.max_gap_s + config.lag_s + 0.2
    assert len(positions_by_stamp(run)) >= 38


@pytest.mark.parametrize("interval_s", [0.1, 5.0])
def test_repeated_messages_have_no_effect(interval_s: float) -> None:
    config, since_s = config_of(3, max_gap_s=8.0), periodic_times(interval_s)[:20]
    of_two, interrupted = [arrivals(number, since_s) for number in (0, 1)], arrivals(2, since_s[:10])
    last = interrupted[-1]
    repeated = [replace(last, receive_ns=last.receive_ns + round(s * SECOND_NS)) for s in np.arange(0.03, 20.0, 0.07)]
    run = run_of(config, *of_two, interrupted, repeated)
    assert run.reasons(last.topic).keys() <= {"duplicate", "late"}
    # The run with the repetitions may be longer; all positions are published within the shorter one.
    assert results(run) == results(run_of(config, *of_two, interrupted))


def test_late_directions_to_dropped_targets_drop_no_other() -> None:
    config = config_of(2)
    of_two = [arrivals(number, np.arange(0.0, 10.0, 0.5)) for number in (0, 1)]
    early = arrivals(0, [0.1])[0]

    def of(name: str, stamped: Arrival) -> Arrival:
        return changed_copy(stamped, lambda message: setattr(message, "target_id", name), early.receive_ns + SECOND_NS)

    # The flood has more targets than are followed, so some are dropped. Then late directions to new targets arrive.
    flood = [of(f"x{number}", arrivals(0, [1.0])[0]) for number in range(MAX_TARGETS + 5)]
    late = [replace(of(f"y{number}", early), receive_ns=START_NS + 5 * SECOND_NS) for number in range(MAX_TARGETS)]
    run = run_of(config, *of_two, flood, late)
    assert run.reasons(early.topic)["late"] >= MAX_TARGETS
    assert results(run) == results(run_of(config, *of_two, flood))


def results(run: AdapterRun) -> list[tuple[int, Any]]:
    """Return time and bytes of each position."""
    return [(ns, exact_value(message)) for ns, topic, message in run.published if topic == POSITION_TOPIC]
