"""Expected availability: fractions equal to those of the page, and proposed limits that are met."""

import math
from pathlib import Path

import numpy as np
import pytest

from ship_testing.monitored_voyages import records, replay_with_faults
from ship_watch.safety.availability import REQUIRED_SHARE, START_UP_S, AvailabilityRecord
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import Safety

SECOND = 1_000_000_000


def record_of(outputs: Path, limits: Limits) -> AvailabilityRecord:
    record = AvailabilityRecord(limits)
    for time_ns, topic, message in records(outputs):
        record.process_message(topic, message, time_ns)
    return record


def safe_share(outputs: Path, limits: Limits) -> float:
    """Return the fraction of the time, without start and star outage, for which pitch and roll are SAFE."""
    monitor, due_ns, first_ns = SuiteMonitor(limits), 0, 0
    safety: list[bool] = []
    for time_ns, topic, message in records(outputs):
        first_ns = first_ns or time_ns
        due_ns = due_ns or time_ns + round(START_UP_S * SECOND)
        while due_ns <= time_ns:
            if not 69.0 < (due_ns - first_ns) * 1e-9 < 100.0:
                angles = monitor.current_state(due_ns).angles
                safety.append(all(angle.safety is Safety.SAFE for angle in angles[1:3]))
            due_ns += SECOND // 10
        monitor.process_message(topic, message, time_ns)
    return sum(safety) / len(safety)


@pytest.mark.parametrize("tilt_arcsec", [2.0, 3.0, 3.2, 4.0])
def test_share_equals_that_of_the_page(tilt_arcsec: float, tmp_path: Path) -> None:
    """The fractions include the hysteresis; 20 s of clouds and some seconds around them are ignored in both."""
    _, outputs = replay_with_faults(tmp_path, "demo")
    limits = Limits(tilt_arcsec=tilt_arcsec)
    found = record_of(outputs, limits).availability("tilt")
    assert found is not None
    assert found.share == pytest.approx(safe_share(outputs, limits), abs=0.05)
    assert found.limit_arcsec == pytest.approx(tilt_arcsec)


def test_proposed_limit_is_the_lowest_round_one_that_is_met(tmp_path: Path) -> None:
    _, outputs = replay_with_faults(tmp_path, "demo")
    proposed = {}
    for quantity in ("heading", "tilt"):
        found = record_of(outputs, Limits()).availability(quantity)
        assert found is not None
        assert found.proposed_share >= REQUIRED_SHARE
        proposed[quantity] = found.proposed_arcsec
        assert found.other
        assert 0.6 < found.decisive_share < 0.8
    assert proposed == {"heading": 5.0, "tilt": 4.0}
    lower = record_of(outputs, Limits(heading_arcsec=4.0, tilt_arcsec=3.0))
    shares = [found.share for name in proposed if (found := lower.availability(name)) is not None]
    assert len(shares) == 2
    assert max(shares) < REQUIRED_SHARE


def test_unpublished_quantity_has_no_availability(tmp_path: Path) -> None:
    _, outputs = replay_with_faults(tmp_path, "demo")
    assert record_of(outputs, Limits()).availability("pointing") is None
    assert AvailabilityRecord(Limits()).availability("heading") is None


def test_unknown_accuracy_is_within_no_limit(tmp_path: Path) -> None:
    """Half of the outputs have no covariance: they are not SAFE with any limit."""
    _, outputs = replay_with_faults(tmp_path, "demo")
    record, start_ns = AvailabilityRecord(Limits()), 0
    for time_ns, topic, message in records(outputs):
        start_ns = start_ns or time_ns
        if topic == "ship/attitude" and (time_ns - start_ns) // (10 * SECOND) % 2:
            message.covariance = np.full(9, math.nan)
        record.process_message(topic, message, time_ns)
    found = record.availability("heading")
    assert found is not None
    assert found.other["accuracy unknown"] == pytest.approx(0.5, abs=0.06)
    assert found.decisive_share < 0.4
