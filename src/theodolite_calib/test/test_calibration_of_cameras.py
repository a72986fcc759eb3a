"""Parallelism of star cameras, saved and loaded with the rest of the calibration."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ship_bags.errors import BadInput
from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_testing.mount_stars import CAMERA_ID, MOUNTED_DEG, mount_config
from theodolite_calib.adapters.calibration_file import CALIBRATION_FILE
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.optical_axis.calibration import (
    SAVED_NAMES,
    CalibrationPrior,
    camera_names,
    prior_from_state,
    state_from_prior,
)

NOW_NS = 1_767_225_600_000_000_000
OFF = np.array([0.8, -1.1, 0.5]) * ARCSEC
"""Correction of the configured mounting, estimated in one session."""


def calibrated_state(settings: OpticalAxisConfig) -> tuple[CalibrationFilter, CalibrationState]:
    """Return filter and state; the camera's mounting has a third of its configured sigma, correlated with c."""
    filter_ = CalibrationFilter(settings)
    state = filter_.initial_state()
    rows = filter_.model.state_indices(f"telescope.{CAMERA_ID}.parallelism")
    c = filter_.model.state_indices("axes")[2]
    mean, parts = state.mean.copy(), state.covariance_by_source.copy()
    mean[rows], mean[c] = OFF, 3.0 * ARCSEC
    parts[:, rows, :] /= 3.0
    parts[:, :, rows] /= 3.0
    # Azimuth of the camera and collimation are known together.
    parts[0][[rows[0], c], [c, rows[0]]] = 0.05 * ARCSEC**2
    return filter_, replace(filter_.initial_state_from(mean, parts), last_stars_ns=NOW_NS)


def saved_prior(settings: OpticalAxisConfig) -> CalibrationPrior:
    return prior_from_state(calibrated_state(settings)[0], settings, calibrated_state(settings)[1])


def save_and_load(prior: CalibrationPrior, path: Path) -> CalibrationPrior:
    CALIBRATION_FILE.save(path, prior)
    return CALIBRATION_FILE.load(path)


def test_angles_are_saved_and_loaded(tmp_path: Path) -> None:
    settings = mount_config(1.0)
    prior = saved_prior(settings)
    assert prior.names == (*SAVED_NAMES, *camera_names(CAMERA_ID))
    loaded = save_and_load(prior, tmp_path / "calibration.yaml")
    assert loaded.names == prior.names
    assert loaded.values == pytest.approx(prior.values, rel=1e-12, abs=1e-18)
    assert loaded.covariance.tolist() == prior.covariance.tolist()
    azimuth_arcsec = 3600.0 * MOUNTED_DEG["azimuth_deg"] + 0.8
    assert (
        f"telescopes.{CAMERA_ID}.azimuth_arcsec: {azimuth_arcsec:.1f}"[:40]
        in (tmp_path / "calibration.yaml").read_text()
    )
    assert f"telescopes.{CAMERA_ID}.azimuth of theodolite ''" in loaded.sigmas()


def test_next_session_starts_with_the_saved_calibration(tmp_path: Path) -> None:
    settings = mount_config(1.0)
    filter_, before = calibrated_state(settings)
    state, messages = state_from_prior(
        filter_, settings, save_and_load(saved_prior(settings), tmp_path / "c.yaml"), NOW_NS
    )
    assert messages == []
    rows = [*filter_.model.state_indices(f"telescope.{CAMERA_ID}.parallelism"), filter_.model.state_indices("axes")[2]]
    np.testing.assert_allclose(state.mean[rows], before.mean[rows], rtol=1e-6)
    np.testing.assert_allclose(
        state.covariance[np.ix_(rows, rows)], before.covariance[np.ix_(rows, rows)], rtol=1e-9, atol=1e-20
    )
    source = filter_.model.sources.index("saved_calibration")
    assert state.covariance_by_source[source][rows[0], rows[0]] == pytest.approx(before.covariance[rows[0], rows[0]])


@pytest.mark.parametrize("azimuth_deg", [180.0, -180.0, 200.0])
def test_a_camera_that_looks_backward_is_within_half_a_turn(tmp_path: Path, azimuth_deg: float) -> None:
    settings = mount_config(1.0, **{f"telescopes__{CAMERA_ID}__azimuth_deg": azimuth_deg})
    prior = saved_prior(settings)
    place = prior.names.index(f"telescopes.{CAMERA_ID}.azimuth")
    assert wrap_pi(prior.values[place] - np.deg2rad(azimuth_deg)) == pytest.approx(OFF[0], rel=1e-6)
    filter_ = CalibrationFilter(settings)
    state, messages = state_from_prior(filter_, settings, save_and_load(prior, tmp_path / "c.yaml"), NOW_NS)
    assert messages == []
    row = filter_.model.state_indices(f"telescope.{CAMERA_ID}.parallelism")[0]
    assert state.mean[row] == pytest.approx(OFF[0], rel=1e-6)


@pytest.mark.parametrize("angle", ["azimuth", "elevation", "roll"])
def test_remounted_camera_is_ignored_and_the_rest_used(angle: str) -> None:
    mounting = {f"telescopes__{CAMERA_ID}__{angle}_deg": MOUNTED_DEG[f"{angle}_deg"] + 0.1}
    settings = mount_config(1.0, **mounting)
    filter_ = CalibrationFilter(settings)
    state, (message,) = state_from_prior(filter_, settings, saved_prior(mount_config(1.0)), NOW_NS)
    assert message.startswith(f"saved calibration of camera '{CAMERA_ID}' is not used: its {angle} is 3")
    rows, initial = filter_.model.state_indices(f"telescope.{CAMERA_ID}.parallelism"), filter_.initial_state()
    assert state.mean[rows].tolist() == [0.0, 0.0, 0.0]
    assert state.covariance[np.ix_(rows, rows)].tolist() == initial.covariance[np.ix_(rows, rows)].tolist()
    assert state.mean[filter_.model.state_indices("axes")[2]] == pytest.approx(3.0 * ARCSEC)


def test_removed_camera_is_ignored() -> None:
    settings = replace(mount_config(1.0), telescopes={})
    filter_ = CalibrationFilter(settings)
    state, (message,) = state_from_prior(filter_, settings, saved_prior(mount_config(1.0)), NOW_NS)
    why = "no camera of this name with angles of its own is configured"
    assert message == f"saved calibration of camera '{CAMERA_ID}' is not used: {why}"
    assert state.mean[filter_.model.state_indices("axes")[2]] == pytest.approx(3.0 * ARCSEC)


def test_a_file_without_cameras_leaves_them_as_configured() -> None:
    without = replace(mount_config(1.0), telescopes={})
    filter_ = CalibrationFilter(without)
    old = prior_from_state(filter_, without, replace(filter_.initial_state(), last_stars_ns=NOW_NS))
    assert old.names == SAVED_NAMES
    settings = mount_config(1.0)
    filter_ = CalibrationFilter(settings)
    state, messages = state_from_prior(filter_, settings, old, NOW_NS)
    assert messages == []
    rows = filter_.model.state_indices(f"telescope.{CAMERA_ID}.parallelism")
    assert np.sqrt(np.diagonal(state.covariance)[rows]) == pytest.approx(ARCSEC)


def test_camera_without_covariance_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    CALIBRATION_FILE.save(path, saved_prior(mount_config(1.0)))
    path.write_text(path.read_text().replace("values:\n", "values:\n  telescopes.other.roll_arcsec: 3.0\n", 1))
    with pytest.raises(BadInput, match="'covariance': shape"):
        CALIBRATION_FILE.load(path)
