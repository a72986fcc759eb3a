"""Deflection of the vertical through the adapter of the node: reading, rejection, publication and diagnostics."""

import math
from typing import Any

import numpy as np
import pytest

from ship_bags.stamps import make_header
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_stars.attitude_samples import Horizon
from ship_testing.adapter_runs import FACTORY, SECOND_NS, START_NS, Arrival, sort_by_arrival
from ship_testing.small_voyage import Run, new_adapter, run_adapter, voyage

TOPIC = "gravity/deflection"
END_NS = START_NS + 5 * SECOND_NS


def deflection_message(
    since_s: float, xi_arcsec: float, eta_arcsec: float, sigma_arcsec: float = 1.0, **changes: Any
) -> Arrival:
    time_ns = START_NS + round(since_s * SECOND_NS)
    values = {
        "header": make_header(FACTORY, time_ns, "gravity"),
        "xi": xi_arcsec * ARCSEC,
        "eta": eta_arcsec * ARCSEC,
        "covariance": (np.eye(2) * (sigma_arcsec * ARCSEC) ** 2).ravel(),
    } | changes
    return Arrival(TOPIC, FACTORY.make("ship_msgs/msg/Deflection", **values), time_ns)


def run_with(*messages: Arrival, **parameters: Any) -> Run:
    adapter = new_adapter(gravity__deflection="topic", **parameters)
    return run_adapter(adapter, sort_by_arrival([*voyage(), *messages]), END_NS)


def test_a_received_deflection_is_published_with_the_correction_by_stars() -> None:
    run = run_with(deflection_message(-1.0, 4.0, -3.0))
    published = run.messages("ship/deflection")
    assert len(published) >= 4
    last = published[-1]
    # The INS errors of this voyage are 10 and 8 arcseconds: no reason to reject the deflection.
    assert (last.xi / ARCSEC, last.eta / ARCSEC) == (pytest.approx(4.0, abs=1.0), pytest.approx(-3.0, abs=1.0))
    sigma_arcsec = np.sqrt(np.asarray(last.covariance)[[0, 3]]) / ARCSEC
    assert np.all((sigma_arcsec > 0.5) & (sigma_arcsec <= 1.0))
    claimed = [message for message in run.messages("ship/attitude") if message.status != Status.INVALID]
    assert {message.horizon for message in claimed} == {Horizon.GEODETIC}
    assert [text for _, text in run.diagnostics("vertical", START_NS, END_NS)][-1].startswith("the deflection")


def test_budget_holds_the_deflection_and_adds_up() -> None:
    budget = run_with(deflection_message(-1.0, 4.0, -3.0)).messages("ship/error_budget")[-1]
    assert "deflection" in budget.sources
    parts = np.asarray(budget.covariances).reshape(-1, 3, 3)
    np.testing.assert_allclose(parts.sum(axis=0).ravel(), budget.total, rtol=1e-9, atol=1e-9 * np.max(budget.total))


def test_without_the_parameter_the_topic_is_not_read_and_nothing_is_published() -> None:
    run = run_adapter(new_adapter(), voyage(), END_NS)
    assert not run.messages("ship/deflection")
    assert not run.diagnostics("vertical", START_NS, END_NS)
    assert TOPIC not in {known.topic for known in new_adapter().inputs}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"xi": math.nan}, "non_finite"),
        ({"eta": math.inf}, "non_finite"),
        ({"xi": 4.0}, "units"),
        ({"covariance": np.array([math.nan, 0.0, 0.0, 1e-12])}, "bad_covariance"),
        ({"covariance": np.array([1e-12, 0.0, 0.0, -1e-12])}, "bad_covariance"),
        ({"covariance": np.array([1e-12, 1e-12, 0.0, 1e-12])}, "bad_covariance"),
    ],
)
def test_bad_messages_are_rejected_and_change_nothing(changes: dict[str, Any], reason: str) -> None:
    good, bad = deflection_message(-1.0, 4.0, -3.0), deflection_message(1.0, 40.0, 40.0, **changes)
    run = run_with(good, bad)
    assert run.reasons(TOPIC) == {reason: 1}
    assert run.results() == run_with(good).results()


def test_a_topic_timeout_is_named_and_the_horizon_is_gravity_without_stars() -> None:
    messages = [deflection_message(-1.0, 4.0, -3.0)]
    run = run_with(*messages, gravity__max_age_s=2.0)
    texts = [text for _, text in run.diagnostics("vertical", START_NS, END_NS)]
    assert texts[-1] == "no message on gravity/deflection within max_age_s = 2"


def test_two_messages_of_one_stamp_are_reported() -> None:
    assert run_with(deflection_message(0.5, 4.0, -3.0), deflection_message(0.5, 4.0, -3.0)).reasons(TOPIC) == {
        "duplicate": 1
    }
    one, other = deflection_message(0.5, 4.0, -3.0), deflection_message(0.5, 5.0, -3.0)
    runs = [run_with(one, other), run_with(other, one)]
    assert [run.reasons(TOPIC) for run in runs] == [{"conflict": 1}] * 2
    states = [run.state() for run in runs]
    assert states[0] == states[1]
