"""The attitude that is put out: a function of state and samples that takes one sample or a stack of them."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.output import CorrectedIns
from ship_estimation.hypotheses import covariances
from ship_estimation.ins import InsJump
from ship_estimation.parameters import build
from ship_geometry.rotations import ARCSEC

FILTER = ShipFilter(
    build(ShipAttitudeConfig, {"star_sensors": {"fore": {"azimuth_deg": 10.0, "elevation_deg": 40.0}}})
)
SAMPLES = 40


@pytest.mark.parametrize("sigma_rad", [30.0 * ARCSEC, 0.1], ids=["as aboard", "large errors"])
def test_a_stack_of_samples_gives_what_the_single_calls_give(sigma_rad: float) -> None:
    rng = np.random.default_rng(7)
    initial = FILTER.initial_state()
    root = rng.normal(scale=sigma_rad, size=initial.parts.shape)
    mean = rng.normal(scale=sigma_rad, size=FILTER.model.size)
    started = FILTER.suspects.start(mean, root @ root.transpose(0, 2, 1))
    state = replace(started, time_ns=1_000_000_000)
    corrected = CorrectedIns(FILTER, state)
    since_s = np.concatenate([[0.0], rng.uniform(0.0, 1e4, SAMPLES - 1)])
    lower = rng.normal(scale=1e-5, size=(SAMPLES, 3, 3))
    ins = (
        Rotation.random(SAMPLES, random_state=7).as_matrix(),
        rng.normal(scale=0.1, size=(SAMPLES, 3)),
        rng.uniform(0.3, 1.0, SAMPLES),
        lower @ lower.transpose(0, 2, 1),
    )
    rotations, parts = corrected.attitudes(since_s, *ins)
    assert rotations.shape == (SAMPLES, 3, 3)
    assert parts.shape == (SAMPLES, len(FILTER.model.sources), 3, 3)
    for row in range(SAMPLES):
        alone = slice(row, row + 1)
        rotation, of_one = corrected.attitudes(since_s[alone], *(values[alone] for values in ins))
        assert rotations[row].tobytes() == rotation.tobytes()
        assert parts[row].tobytes() == of_one.tobytes()


def test_each_row_of_a_state_is_predicted_and_opened_as_if_it_were_alone() -> None:
    rng = np.random.default_rng(11)
    rows, initial = 5, FILTER.initial_state()
    means = rng.normal(scale=1e-4, size=(rows, FILTER.model.size))
    root = rng.normal(scale=1e-4, size=(len(initial.parts) + rows - 1, FILTER.model.size, FILTER.model.size))
    stack = root @ root.swapaxes(-1, -2)
    common_n = MappingProxyType({"star.fore": (20.0 * ARCSEC) ** 2 * np.eye(3)})
    jump = InsJump(61_000_000_000, np.array([0.0, 0.01, 0.0]), 1e-4)
    together = replace(initial, time_ns=1_000_000_000, means=means, stack=stack, common_n=common_n)
    after = FILTER.opened(FILTER.predicted(together, 31_000_000_000), jump)
    for row in range(rows):
        parts = np.zeros_like(initial.parts)
        parts[0] = covariances(stack, rows)[row]
        one = replace(together, means=means[row : row + 1], stack=parts)
        alone = FILTER.opened(FILTER.predicted(one, 31_000_000_000), jump)
        assert after.means[row].tobytes() == alone.mean.tobytes()
        np.testing.assert_allclose(covariances(after.stack, rows)[row], alone.covariance, rtol=1e-12, atol=1e-20)
