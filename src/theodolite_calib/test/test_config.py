"""Parameters of optical_axis that are refused, with what was expected."""

import pytest

from ship_estimation.parameters import ParameterError, build
from ship_testing.small_session import config
from theodolite_calib.config import OpticalAxisConfig

REFUSED = [
    ({"telescope__focal_length_m": 0.0}, r"'telescope.focal_length_m' = 0.0 m is out of its range \[0.001, 10.0\] m"),
    ({"telescope__focal_length_m": 100.0}, r"'telescope.focal_length_m' = 100.0 m is out of .* \[0.001, 10.0\] m"),
    ({"lever__forward_m": 200.5}, r"'lever.forward_m' = 200.5 m is out of its range \[-200.0, 200.0\] m"),
    ({"telescope__lens__up_m": -300.0}, r"'telescope.lens.up_m' = -300.0 m is out of its range"),
    ({"beacons__alpha__light__right_m": 1000.0}, r"'beacons.alpha.light.right_m' = 1000.0 m is out of its range"),
    ({"axes__g_sigma_arcsec": float("nan")}, "'axes.g_sigma_arcsec' must be finite"),
    ({"ship__source": "gyro"}, "'ship.source' = 'gyro' must be one of ship/attitude, ins/imu"),
    ({"telescope__focal_length_mm": 100.0}, "'telescope.focal_length_mm' is unknown: expected one of"),
    ({"least_fix": "single"}, "must be one of fixed, float"),
]


@pytest.mark.parametrize(("changes", "text"), REFUSED)
def test_what_cannot_be_is_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(ParameterError, match=text):
        config(**changes)


def test_telescope_and_focal_length_must_be_given() -> None:
    with pytest.raises(ParameterError, match=r"'telescope.telescope_id' \(telescope_id of its images\) must be given"):
        build(OpticalAxisConfig, {})
    with pytest.raises(ParameterError, match=r"'telescope\.focal_length_m'"):
        build(OpticalAxisConfig, {"telescope": {"telescope_id": "main"}})
