"""Fault detector of a table of two stars and an INS: masks, timers, exclusion and reinstatement."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np

from ship_estimation.fault_detection.exclusion import ExcludedSource, FaultState, SourceExclusion, UnresolvedFault
from ship_estimation.fault_detection.isolation import initial_means
from ship_estimation.fault_detection.subfilters import SubfilterTable
from ship_estimation.innovations.gates import GateConfig
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_geometry.earth.time_scales import SECOND_NS

TABLE = SubfilterTable(
    ("aft", "fore"), (("aft",), ("fore",), ("ins",)), dict.fromkeys(("aft", "fore", "ins"), 1e-3), IntegrityConfig()
)
EXCLUSION = SourceExclusion(TABLE, 5.0, GateConfig(), IntegrityConfig())


def excluded_state(measured_s: tuple[int, int]) -> FaultState:
    """Return a state with "aft" and the INS excluded and consistent since 1 s, with the last stamp of each star."""
    means = replace(
        initial_means(TABLE.count, 2),
        last_measured_ns=np.array(measured_s) * SECOND_NS,
        rejection_counts=np.ones((TABLE.count, 2), dtype=np.int64),
    )
    one = ExcludedSource(0, consistent_since_ns=SECOND_NS)
    fault = UnresolvedFault("", np.eye(3), consistent_since_ns=SECOND_NS)
    excluded = MappingProxyType({"aft": one, "ins": one})
    return FaultState(innovation_means=means, excluded=excluded, unresolved_fault=fault)


def test_no_filter_uses_an_excluded_source_and_its_subfilter_is_no_candidate() -> None:
    state = excluded_state((0, 0))
    assert EXCLUSION.uses(state).tolist() == [[False, True], [False, True], [False, False], [False, True]]
    assert EXCLUSION.candidates(state) == [TABLE.subfilter_of("fore")]
    assert state.in_use(TABLE.sources, 5 * SECOND_NS) == ["fore"]


def test_timers_restart_after_a_gap_of_their_source_or_of_all_sources() -> None:
    for measured_s, aft, others in (((95, 99), 1, (1, 1)), ((80, 99), None, (1, 1)), ((80, 80), None, (100, None))):
        after = EXCLUSION.restart_timers(excluded_state(measured_s), ("aft", "fore"), 100 * SECOND_NS)
        assert after.unresolved_fault is not None
        found = after.excluded["aft"], after.excluded["ins"], after.unresolved_fault
        expected = [None if since_s is None else since_s * SECOND_NS for since_s in (aft, *others)]
        assert [one.consistent_since_ns for one in found] == expected


def test_a_reinstated_source_starts_with_cleared_means_in_the_filters_that_use_it() -> None:
    after = EXCLUSION.reinstate(excluded_state((0, 0)), ("aft", "ins"))
    assert not after.excluded
    assert after.innovation_means.rejection_counts.tolist() == [[0, 1], [1, 1], [0, 1], [0, 1]]


def test_an_exclusion_ends_an_unresolved_fault() -> None:
    state = excluded_state((0, 0))
    after = EXCLUSION.exclude(state, {"fore": ExcludedSource(7)}, initial_means(TABLE.count, 2))
    assert (set(after.excluded), after.unresolved_fault) == ({"aft", "fore", "ins"}, None)
    assert EXCLUSION.is_consistent(after, "fore")
