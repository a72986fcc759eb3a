"""Jacobians against central differences, and the rotation chain against its definition."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.corrected_ins import CorrectedIns, corrected_attitudes
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.ship_attitude.measurements.prediction import predict_attitude
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.parameters.schema import build
from ship_geometry.rotations import FloatArray, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import InterpolatedAttitude, PropagatedBlock
from ship_stars.attitude_samples import AttitudeMeasurement

CONFIG = build(
    ShipAttitudeConfig,
    {
        "ins": {"time_offset_s": 0.01},
        "star_sensors": {
            "fore": {
                "azimuth_deg": 10.0,
                "elevation_deg": 40.0,
                "roll_deg": -30.0,
                "time_offset_sigma_s": 0.001,
                "flexure_sigma_arcsec": 5.0,
            },
            "plain": {"azimuth_deg": 250.0, "elevation_deg": 85.0},
        },
        "references": {"other": {"heading_deg": -0.8, "slow_sigma_heading_arcsec": 10.0, "time_offset_s": 0.1}},
    },
)
FILTER = ShipFilter(CONFIG)
MODEL = FILTER.model
DEVICES = CONFIG.devices
STEP = 1e-6


def random_case(seed: int) -> tuple[np.ndarray, InterpolatedAttitude]:
    """Return a state with errors of about half a degree, so that second-order terms matter, and a moving ship's INS."""
    rng = np.random.default_rng(seed)
    mean = rng.normal(scale=0.01, size=MODEL.size)
    rotation = Rotation.random(random_state=seed).as_matrix()
    return mean, InterpolatedAttitude(rotation, rng.normal(scale=0.1, size=3), noise_gain=0.6)


def with_state_error(mean: np.ndarray, index: int, by: float) -> np.ndarray:
    mean_with_error = mean.copy()
    mean_with_error[index] += by
    return mean_with_error


def ins_at_changed_offsets(
    name: str, mean: np.ndarray, changed: np.ndarray, ins: InterpolatedAttitude
) -> InterpolatedAttitude:
    """Return the INS attitude at the time given by the changed clock offsets, for a constant rate of the ship."""
    # The shift is a float in seconds, because whole nanoseconds would round the small step.
    shift_s = sum(
        sign * (changed[MODEL.slices[state]][0] - mean[MODEL.slices[state]][0])
        for state, sign in DEVICES[name].ins_time_states
    )
    return InterpolatedAttitude(ins.rotation_nd @ exp_rotation(ins.rate_d * shift_s), ins.rate_d, ins.noise_gain)


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("seed", range(5))
def test_jacobian_of_a_device_is_its_central_difference(name: str, seed: int) -> None:
    mean, ins = random_case(seed)
    predicted = predict_attitude(DEVICES[name], MODEL, mean, ins)
    for index in range(MODEL.size):
        turns = []
        for by in (STEP, -STEP):
            changed = with_state_error(mean, index, by)
            rotation = predict_attitude(
                DEVICES[name], MODEL, changed, ins_at_changed_offsets(name, mean, changed, ins)
            ).rotation_nv
            turns.append(log_rotation(predicted.rotation_nv.T @ rotation))
        difference = (turns[0] - turns[1]) / (2.0 * STEP)
        assert predicted.jacobian_v[:, index] == pytest.approx(difference, abs=1e-7), MODEL.slices


def test_chain_of_a_star_sensor_is_that_of_the_model() -> None:
    """models.md §4: R_measured = exp(c) exp(a) exp(w) R_i exp(f) R0 exp(m), by scipy."""
    mean, ins = random_case(1)

    def exp(name: str, scale: float = 1.0) -> np.ndarray:
        return Rotation.from_rotvec(scale * mean[MODEL.slices[name]]).as_matrix()

    expected = (
        exp("star.fore.common")
        @ exp("ins.attitude")
        @ exp("ins.noise", np.sqrt(0.6))
        @ ins.rotation_nd
        @ exp("star.fore.flexure")
        @ DEVICES["star.fore"].rotation_dv0
        @ exp("star.fore.installation")
    )
    assert predict_attitude(DEVICES["star.fore"], MODEL, mean, ins).rotation_nv == pytest.approx(expected, abs=1e-14)


def test_clock_offsets_have_the_signs_of_the_contract() -> None:
    """An INS sample is valid at stamp + tau; a reference's offset is its stamp minus the INS stamp at that time."""
    mean = np.zeros(MODEL.size)
    mean[MODEL.slices["ins.time_offset"]] = 0.005
    mean[MODEL.slices["star.fore.time_offset"]] = 0.001
    mean[MODEL.slices["reference.other.time_offset"]] = 0.002
    one_second, state = (
        1_000_000_000,
        FILTER.fault_detector.initial_state(mean, FILTER.initial_state().covariance_by_source),
    )
    shifts_ms = {"star.plain": -15, "star.fore": -14, "reference.other": -102}
    for source, shift_ms in shifts_ms.items():
        measurement = AttitudeMeasurement(source, one_second, np.eye(3), np.eye(3))
        assert FILTER.linearisation.ins_time_ns(state.mean, measurement) == one_second + shift_ms * 1_000_000


def correct_directly(state: FilterState, ins: InterpolatedAttitude) -> tuple[FloatArray, FloatArray]:
    """Return the attitude at the time of the state, and the attitude covariance by source."""
    of_one = ins.rotation_nd[None], ins.rate_d[None], np.array([ins.noise_gain]), ins.error_covariance_d[None]
    by = [CorrectedIns(FILTER, state, ShipAttitudeConfig())], np.zeros(1, dtype=np.intp)
    (rotation,), (parts,) = corrected_attitudes(*by, np.zeros(1), PropagatedBlock(*of_one))
    return rotation, parts


@pytest.mark.parametrize("seed", range(5))
def test_covariance_of_the_output_is_that_of_its_errors(seed: int) -> None:
    """Output covariance = G P G^T + white noise, with G by central differences of the published attitude."""
    rng = np.random.default_rng(seed)
    mean, ins = random_case(seed)
    root = rng.normal(scale=1e-5, size=(MODEL.size, MODEL.size))
    parts = np.zeros((len(MODEL.sources), MODEL.size, MODEL.size))
    parts[0] = root @ root.T
    state = replace(FILTER.fault_detector.initial_state(mean, parts), time_ns=1_000_000_000)
    rotation, covariance_parts = correct_directly(state, ins)

    jacobian = np.zeros((3, MODEL.size))
    tau = MODEL.slices["ins.time_offset"].start
    for index in range(MODEL.size):
        turns = []
        for by in (STEP, -STEP):
            changed = replace(
                FILTER.fault_detector.initial_state(with_state_error(mean, index, by), parts), time_ns=state.time_ns
            )
            shift_s = -by if index == tau else 0.0
            shifted = InterpolatedAttitude(ins.rotation_nd @ exp_rotation(ins.rate_d * shift_s), ins.rate_d, 0.6)
            turns.append(log_rotation(correct_directly(changed, shifted)[0] @ rotation.T))
        jacobian[:, index] = (turns[0] - turns[1]) / (2.0 * STEP)
    white = np.diag(MODEL.blocks["ins.noise"].sigma ** 2) * 0.6
    expected = jacobian @ parts[0] @ jacobian.T + white
    assert covariance_parts.sum(axis=0) == pytest.approx(expected, rel=1e-5, abs=1e-16)
