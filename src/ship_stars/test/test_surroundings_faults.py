"""A jump of a fix or of a barometer is reported and affects no star, in both nodes that use the sky."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_testing import ship_observations, star_voyage
from ship_testing.adapter_runs import SECOND_NS, START_NS, Arrival, change_where, delay_arrivals, sort_by_arrival
from ship_testing.small_voyage import INS
from ship_testing.star_voyage import FIX, FORE, PRESSURE, STARBOARD, fix, without_topics
from ship_testing.star_voyage import voyage as short_voyage

Change = Callable[[Any], None]
NODES = {"ship_attitude": ship_observations.run_new_adapter, "star_attitude": star_voyage.run_new_adapter}


def offset_by(field: str, by: float) -> Change:
    def change(message: Any) -> None:
        setattr(message, field, getattr(message, field) + by)

    return change


FAULTS = {
    # 300 m, 1 km and 10 km; the radius of the meridian at 32° is 6353 km.
    "300 m north": (FIX, offset_by("latitude", np.rad2deg(300.0 / 6_353_000.0))),
    "1 km south": (FIX, offset_by("latitude", np.rad2deg(-1000.0 / 6_353_000.0))),
    "10 km east": (FIX, offset_by("longitude", np.rad2deg(10_000.0 / (6_384_100.0 * np.cos(np.deg2rad(31.9)))))),
    "20 hPa up": (PRESSURE, offset_by("fluid_pressure", 2000.0)),
    "30 hPa down": (PRESSURE, offset_by("fluid_pressure", -3000.0)),
}


def voyage() -> tuple[Arrival, ...]:
    """Return the voyage of a ship whose position has been established before."""
    before = [since_s * SECOND_NS for since_s in range(-12, -2)]
    return (*(Arrival(FIX, fix(since_ns), START_NS + since_ns + 50_000_000) for since_ns in before), *short_voyage())


def is_hit(arrival: Arrival, topic: str) -> bool:
    return arrival.topic == topic and arrival.stamp_ns >= START_NS + SECOND_NS


@pytest.mark.slow
@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("fault", FAULTS)
def test_jumps_are_reported_and_change_nothing(node: str, fault: str) -> None:
    topic, change = FAULTS[fault]
    run = NODES[node](change_where(voyage(), lambda arrival: is_hit(arrival, topic), change))
    without = NODES[node]([arrival for arrival in voyage() if not is_hit(arrival, topic)])
    assert run.results() == without.results()
    assert run.reasons(topic) == {"jump": 2}
    jumps = run.innovations(Reason.JUMP)
    assert [message.source for message in jumps] == [topic] * 2
    assert all("from the last accepted value" in message.reason_text for message in jumps)


def test_the_attitude_stays_valid() -> None:
    topic, change = FAULTS["1 km south"]
    run = ship_observations.run_new_adapter(change_where(voyage(), lambda arrival: is_hit(arrival, topic), change))
    # The first half second is left out: there is no INS sample yet, or not both sensors are in use.
    later = [m.status for ns, t, m in run.published if t == "ship/attitude" and ns > START_NS + SECOND_NS // 2]
    assert set(later) == {Status.VALID}
    reports = run.diagnostics(f"input {FIX}", START_NS, START_NS + 4 * SECOND_NS)
    assert any(level > 0 and text.startswith("rejected, jump: ") for level, text in reports)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_any_order_within_the_lag_gives_the_same_state(seed: int) -> None:
    wrong = change_where(
        voyage(),
        # The fix at 0 s and the last fix, at 2 s, are wrong; the fix between is compared with correct fixes.
        lambda arrival: arrival.topic == FIX and arrival.stamp_ns in (START_NS, START_NS + 2 * SECOND_NS),
        FAULTS["1 km south"][1],
    )
    late = np.array([arrival.topic in (FIX, PRESSURE, FORE, STARBOARD, INS) for arrival in wrong])
    delays_s = np.where(late, np.random.default_rng(seed).uniform(0.0, 1.99, late.size), 0.005)
    run = ship_observations.run_new_adapter(delay_arrivals(wrong, delays_s))
    ordered = ship_observations.run_new_adapter(delay_arrivals(wrong, np.full(late.size, 0.005)))
    assert ordered.reasons(FIX) == {"jump": 2}
    assert run.state() == ordered.state()


def to_zero(message: Any) -> None:
    message.latitude = message.longitude = 0.0


@pytest.mark.slow
@pytest.mark.parametrize("node", NODES)
def test_a_first_position_that_others_contradict_is_replaced_by_ten_of_them(node: str) -> None:
    """Five fixes at 0° N 0° E, then good ones, at 5 Hz: no star is used before ten good fixes have arrived."""
    period_ns, first_ns = SECOND_NS // 5, -2 * SECOND_NS // 5
    fixes = [
        Arrival(FIX, fix(since_ns), START_NS + since_ns + 50_000_000)
        for since_ns in range(first_ns, 5 * SECOND_NS, period_ns)
    ]
    good_ns, settled_ns = (START_NS + first_ns + count * period_ns for count in (5, 14))
    fixes = change_where(fixes, lambda arrival: arrival.stamp_ns < good_ns, to_zero)
    run = NODES[node](sort_by_arrival([*without_topics(short_voyage(5.0), FIX), *fixes]))
    assert run.reasons(FIX) == {"jump": 9}
    assert "10 in a row are consistent" in run.innovations(Reason.JUMP)[0].reason_text
    output, valid = ("ship/attitude", Status.VALID) if node == "ship_attitude" else ("star/fore/solution", 0)
    statuses = [(ns, message.status) for ns, topic, message in run.published if topic == output]
    assert valid not in {status for ns, status in statuses if START_NS < ns < settled_ns}
    assert {status for ns, status in statuses if settled_ns + 1.2 * SECOND_NS < ns < START_NS + 5 * SECOND_NS} == {
        valid
    }
