"""The filters of a ship: excluded sources, maximum number, and use of subfilters without two sources."""

from typing import Any

import pytest
from scipy.stats import norm

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.model import ShipSubfilters
from ship_estimation.parameters.schema import ParameterError, build


def subfilter_set(sensors: int, references: int = 0, **integrity: Any) -> ShipSubfilters:
    stars = {f"s{number}": {"azimuth_deg": 60.0 * number, "elevation_deg": 45.0} for number in range(sensors)}
    others: dict[str, Any] = {f"r{number}": {} for number in range(references)}
    values = {"star_sensors": stars, "references": others, "integrity": integrity}
    return ShipFilter(build(ShipAttitudeConfig, values)).fault_detector.subfilters


def test_each_source_and_each_pair_of_three_and_the_ins_is_excluded_in_one_subfilter() -> None:
    found = subfilter_set(2, 1, pairs=True, max_hypotheses=11)
    assert found.names[:4] == ("star.s0", "star.s1", "reference.r0", "ins")
    assert found.names[4:] == (
        "star.s0+star.s1",
        "star.s0+reference.r0",
        "star.s0+ins",
        "star.s1+reference.r0",
        "star.s1+ins",
        "reference.r0+ins",
    )
    for subfilter, names in enumerate(found.excluded_sources, start=1):
        assert {found.sources[source] for source in (~found.uses[subfilter]).nonzero()[0]} == set(names) - {"ins"}
        assert (subfilter in found.ins_subfilters) == ("ins" in names)
    assert found.uses[0].all()


@pytest.mark.parametrize("sensors", [0, 1, 2])
def test_fewer_than_three_sources_have_no_pairs(sensors: int) -> None:
    assert subfilter_set(sensors, pairs=True).names == subfilter_set(sensors).names
    assert subfilter_set(3).pair_subfilters == range(5, 5)


def test_consistent_star_sensors_cannot_show_an_ins_fault() -> None:
    found = subfilter_set(3, 1)
    assert not found.can_show_ins_fault(["star.s0", "star.s1", "star.s2"])
    assert not found.can_show_ins_fault(["reference.r0"])
    assert found.can_show_ins_fault(["star.s0", "reference.r0"])


def test_a_pair_is_as_probable_as_both_of_its_faults_together() -> None:
    found = subfilter_set(
        2, 1, pairs=True, max_hypotheses=11, prior_per_h={"star_sensor": 1e-2, "reference": 0.1, "ins": 1e-3}
    )
    share = 1e-5 / 12  # ten subfilters, all stars together, and the fault-free case
    for name, prior in (("reference.r0", 0.1), ("star.s0+star.s1", 1e-4), ("reference.r0+ins", 1e-4)):
        assert found.k.missed_detection[found.names.index(name)] == pytest.approx(norm.isf(share / prior))


@pytest.mark.parametrize(("sensors", "filters"), [(3, 11), (4, 16)])
def test_more_filters_than_allowed_are_refused_with_a_remedy(sensors: int, filters: int) -> None:
    with pytest.raises(ParameterError) as caught:
        subfilter_set(sensors, pairs=True, max_hypotheses=filters - 1)
    assert caught.value.parameters == ("integrity.max_hypotheses",)
    text = str(caught.value)
    assert f"'integrity.max_hypotheses' = {filters - 1} is less than the {filters} for these sources: star.s0, " in text
    assert "star.s0+star.s1" in text
    assert text.endswith(f"set it to {filters}, or 'integrity.pairs' to false")
    assert subfilter_set(sensors, pairs=True, max_hypotheses=filters).count == filters


def test_a_pair_is_relevant_while_two_others_are_in_use() -> None:
    found, sensors = subfilter_set(4, pairs=True, max_hypotheses=16), [f"star.s{number}" for number in range(4)]

    def relevant_pairs(in_use: list[str], *excluded: str) -> set[str]:
        return {found.names[subfilter - 1] for subfilter in found.relevant_pairs(in_use, excluded)}

    assert relevant_pairs(sensors) == set(found.names[5:])
    # If one source of a pair is excluded, the pair's subfilter equals the one without the other source.
    of_three = {"star.s1+star.s2", "star.s1+star.s3", "star.s2+star.s3", "star.s1+ins", "star.s2+ins", "star.s3+ins"}
    assert relevant_pairs(sensors[1:], "star.s0") == of_three
    assert relevant_pairs(sensors[2:], "star.s0", "star.s1") == set()
    assert relevant_pairs(sensors, "ins") == set()
