"""The published attitude is a function of state and samples, the same for one sample and for a block of samples."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.corrected_ins import CorrectedIns, corrected_attitudes, corrected_estimates
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_estimation.fault_detection.exclusion import ExcludedSource, UnresolvedFault
from ship_estimation.fault_detection.subfilters import filter_covariances
from ship_estimation.parameters.schema import build
from ship_estimation.plausibility.checked_ins import InsJump
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_geometry.tracks.attitude_track import PropagatedBlock
from ship_stars.camera.errors import PixelDwell

FILTER = ShipFilter(
    build(ShipAttitudeConfig, {"star_sensors": {"fore": {"azimuth_deg": 10.0, "elevation_deg": 40.0}}})
)
SAMPLES = 40


@pytest.mark.parametrize("sigma_rad", [30.0 * ARCSEC, 0.1], ids=["as aboard", "large errors"])
def test_a_stack_of_samples_gives_what_the_single_calls_give(sigma_rad: float) -> None:
    rng = np.random.default_rng(7)
    initial = FILTER.initial_state()
    corrected = []
    for scale in (0.5, 1.0, 2.0):
        root = rng.normal(scale=scale * sigma_rad, size=initial.covariance_by_source.shape)
        mean = rng.normal(scale=scale * sigma_rad, size=FILTER.model.size)
        started = FILTER.fault_detector.initial_state(mean, root @ root.transpose(0, 2, 1))
        corrected.append(CorrectedIns(FILTER, replace(started, time_ns=1_000_000_000), ShipAttitudeConfig()))
    by = rng.integers(len(corrected), size=SAMPLES)
    since_s = np.concatenate([[0.0], rng.uniform(0.0, 1e4, SAMPLES - 1)])
    lower = rng.normal(scale=1e-5, size=(SAMPLES, 3, 3))
    moved = PropagatedBlock(
        Rotation.random(SAMPLES, random_state=7).as_matrix(),
        rng.normal(scale=0.1, size=(SAMPLES, 3)),
        rng.uniform(0.3, 1.0, SAMPLES),
        lower @ lower.transpose(0, 2, 1),
    )
    rotations, parts = corrected_attitudes(corrected, by, since_s, moved)
    assert rotations.shape == (SAMPLES, 3, 3)
    assert parts.shape == (SAMPLES, len(FILTER.model.sources), 3, 3)
    for row in range(SAMPLES):
        alone = slice(row, row + 1)
        own, first = [corrected[by[row]]], np.zeros(1, dtype=np.intp)
        rotation, of_one = corrected_attitudes(own, first, since_s[alone], moved.subset(alone))
        assert rotations[row].tobytes() == rotation.tobytes()
        assert parts[row].tobytes() == of_one.tobytes()


def test_attitudes_of_several_states_are_those_of_each_alone() -> None:
    """States: usual, unresolved fault, INS excluded, with separations, before any star, usual with an old star."""
    initial, count, time_ns = FILTER.initial_state(), 4, 60_000_000_000
    usual = replace(initial, time_ns=time_ns, last_used_ns=MappingProxyType({"star.fore": time_ns}))
    states = [
        usual,
        replace(usual, unresolved_fault=UnresolvedFault("offset", 1e-8 * np.eye(3))),
        replace(usual, excluded=MappingProxyType({"ins": ExcludedSource(time_ns)})),
        replace(usual, separation_covariance_n=1e-9 * np.eye(3)),
        initial,
        usual,
    ]
    corrected = [CorrectedIns(FILTER, state, ShipAttitudeConfig()) for state in states]
    times_ns = time_ns + 2_000_000_000 * np.arange(count * len(states))
    rotations, zeros = np.tile(np.eye(3), (len(times_ns), 1, 1)), np.zeros((len(times_ns), 3, 3))
    moved = PropagatedBlock(rotations, np.zeros((len(times_ns), 3)), np.ones(len(times_ns)), zeros)
    runs = corrected_estimates(corrected, [count] * len(states), times_ns, moved)
    statuses = set()
    for number, (run, one) in enumerate(zip(runs, corrected, strict=True)):
        for place in range(count):
            at = slice(count * number + place, count * number + place + 1)
            (alone,) = corrected_estimates([one], [1], times_ns[at], moved.subset(at))
            assert repr(run.estimate(place)) == repr(alone.estimate(0))
            assert run.covariance_by_source_n[place].tobytes() == alone.covariance_by_source_n[0].tobytes()
            assert run.covariance_n[place].tobytes() == alone.covariance_n[0].tobytes()
            assert (
                run.covariance_without_separation_n[place].tobytes()
                == alone.covariance_without_separation_n[0].tobytes()
            )
            statuses.add(run.status[place])
    assert np.all(runs[3].covariance_n != runs[3].covariance_without_separation_n, axis=0).diagonal().all()
    assert statuses == {Status.VALID, Status.DEGRADED, Status.COASTING}


def test_each_filter_is_propagated_and_inflated_independently() -> None:
    rng = np.random.default_rng(11)
    filters, initial = 5, FILTER.initial_state()
    means = rng.normal(scale=1e-4, size=(filters, FILTER.model.size))
    root = rng.normal(
        scale=1e-4, size=(len(initial.covariance_by_source) + filters - 1, FILTER.model.size, FILTER.model.size)
    )
    stack = root @ root.swapaxes(-1, -2)
    common_n = MappingProxyType({"star.fore": (20.0 * ARCSEC) ** 2 * np.eye(3)})
    jump = InsJump(61_000_000_000, np.array([0.0, 0.01, 0.0]), 1e-4)
    dwells = MappingProxyType({"star.fore": PixelDwell(np.eye(3)[:1], 3, 0.5)})
    together = replace(initial, time_ns=1_000_000_000, means=means, stack=stack, common_n=common_n, pixel_dwells=dwells)
    after = FILTER.apply_ins_change(FILTER.propagate(together, 31_000_000_000), jump)
    assert not after.pixel_dwells  # an INS jump ends the pixel dwells
    for index in range(filters):
        parts = np.zeros_like(initial.covariance_by_source)
        parts[0] = filter_covariances(stack, filters)[index]
        one = replace(together, means=means[index : index + 1], stack=parts)
        alone = FILTER.apply_ins_change(FILTER.propagate(one, 31_000_000_000), jump)
        assert after.means[index].tobytes() == alone.mean.tobytes()
        covariance = filter_covariances(after.stack, filters)[index]
        np.testing.assert_allclose(covariance, alone.covariance, rtol=1e-12, atol=1e-20)
