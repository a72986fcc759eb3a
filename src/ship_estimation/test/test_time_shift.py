"""All stamps in a value are shifted together; all other fields are unchanged."""

from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ship_estimation.fault_detection.isolation import initial_means
from ship_estimation.recovery.recoverable_core import with_shifted_stamps
from ship_geometry.earth.time_scales import NEVER_NS


class Jump(NamedTuple):
    since_ns: int
    agreed_ns: int | None
    why: str


@dataclass(frozen=True)
class State:
    time_ns: int | None
    means: np.ndarray
    used_ns: MappingProxyType[str, int]
    jumps: MappingProxyType[str, Jump]
    jump: Jump | None = None
    counts: dict[str, int] = field(default_factory=dict)


def test_all_stamps_are_shifted_by_the_step_and_nothing_else_changes() -> None:
    means = np.arange(3.0)
    jump = Jump(40, None, "jumped")
    used_ns = MappingProxyType({"star": 10, "ins": 20})
    state = State(100, means, used_ns, MappingProxyType({"ins": jump}), jump, {"star": 3})
    shifted = with_shifted_stamps(state, -7)
    assert (shifted.time_ns, dict(shifted.used_ns)) == (93, {"star": 3, "ins": 13})
    assert shifted.jump == shifted.jumps["ins"] == Jump(33, None, "jumped")
    assert shifted.means is means
    assert shifted.counts == {"star": 3}
    assert type(shifted.used_ns) is MappingProxyType
    assert with_shifted_stamps(replace(state, time_ns=None), -7).time_ns is None
    assert state.time_ns == 100


def test_never_stamp_is_not_shifted() -> None:
    means = replace(initial_means(subfilters=1, sources=2), last_measured_ns=np.array([NEVER_NS, 50]))
    assert with_shifted_stamps(means, 7).last_measured_ns.tolist() == [NEVER_NS, 57]
