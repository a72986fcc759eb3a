"""Refused parameters of optical_axis, with the expected values."""

import pytest

from ship_estimation.parameters.schema import ParameterError, build
from ship_testing.small_session import config
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.model import state_model

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
def test_impossible_values_are_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(ParameterError, match=text):
        config(**changes)


NIGHT = {"telescopes__night__camera__focal_length_m": 0.1, "telescopes__night__camera__pixel_pitch_m": 6.5e-6}
MOUNTED = {f"telescopes__night__{name}_deg": 0.1 for name in ("azimuth", "elevation", "roll")}
OF_TELESCOPE = {
    "telescope__telescope_id": "night",
    "telescope__focal_length_m": 0.1,
    "telescope__azimuth_arcsec": 360.0,
    "telescope__elevation_arcsec": 360.0,
    "telescope__rotation_arcsec": 360.0,
    **{f"telescope__{name}_sigma_arcsec": 1.0 for name in ("azimuth", "elevation", "rotation")},
    "telescopes__night__roll_sigma_arcsec": 1.0,
}


@pytest.mark.parametrize("name", ["azimuth", "elevation", "roll"])
def test_a_camera_on_the_mount_without_its_angles_is_refused_by_name(name: str) -> None:
    without = {key: value for key, value in MOUNTED.items() if key != f"telescopes__night__{name}_deg"}
    with pytest.raises(ParameterError, match=rf"'telescopes\.night\.{name}_deg' \(.* in the camera\) must be given"):
        config(**NIGHT, **without)


def test_a_camera_on_the_mount_without_focal_length_is_refused_by_name() -> None:
    with pytest.raises(ParameterError, match=r"'telescopes\.night\.camera\.focal_length_m' .* must be given"):
        config(**MOUNTED)


def test_the_calibration_telescope_has_one_parallelism_by_lights_and_by_stars() -> None:
    names = state_model(config(**NIGHT, **MOUNTED, **OF_TELESCOPE)).slices
    assert "telescope.night.parallelism" not in names
    assert "telescope.night.parallelism" in state_model(config(**NIGHT, **MOUNTED)).slices
    for changes, name, expected in (
        ({"telescope__azimuth_arcsec": 361.0}, "azimuth_deg' = 0.1", "telescope.azimuth_arcsec = 0.10027"),
        ({"telescope__rotation_sigma_arcsec": 2.0}, "roll_sigma_arcsec' = 1", "telescope.rotation_sigma_arcsec = 2"),
        ({"telescope__focal_length_m": 0.2}, "camera.focal_length_m' = 0.1", "telescope.focal_length_m = 0.2"),
    ):
        with pytest.raises(ParameterError, match=f"telescopes.night.{name}.*{expected}"):
            config(**{**NIGHT, **MOUNTED, **OF_TELESCOPE, **changes})


def test_telescope_and_focal_length_must_be_given() -> None:
    with pytest.raises(ParameterError, match=r"'telescope\.focal_length_m' \(focal length, in metres\) must be given"):
        build(OpticalAxisConfig, {})
    with pytest.raises(ParameterError, match=r"'telescope\.telescope_id'"):
        build(OpticalAxisConfig, {"telescope": {"focal_length_m": 0.1}})
