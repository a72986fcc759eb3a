"""Calibration saved and loaded: file, ages, other devices, services; changes while the node runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ship_bags.errors import BadInput
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC
from ship_node.live.node_report import start_line
from ship_testing.adapter_runs import FACTORY, SECOND_NS
from ship_testing.small_session import (
    AXES,
    BEACONS,
    FOCAL_LENGTH_M,
    config,
    fault_free_run,
    new_adapter,
    run_adapter,
    session,
)
from theodolite_calib.adapters.calibration_file import CALIBRATION_FILE
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.optical_axis.calibration import (
    SAVED_NAMES,
    CalibrationPrior,
    calibration_from_state,
    prior_from_state,
    state_from_prior,
)

NOW_NS = session()[-1].receive_ns
DAY_NS = 86400 * SECOND_NS


def save_calibration() -> CalibrationPrior:
    prior = fault_free_run().adapter.core.calibration_to_save()
    assert prior is not None
    return prior


def test_the_file_gives_back_what_was_saved(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "calibration.yaml"
    CALIBRATION_FILE.save(path, save_calibration())
    loaded = CALIBRATION_FILE.load(path)
    assert (loaded.time_ns, loaded.serial, loaded.telescope_id) == (save_calibration().time_ns, "", "main")
    assert loaded.values == pytest.approx(save_calibration().values, rel=1e-12, abs=1e-18)
    assert loaded.covariance.tolist() == save_calibration().covariance.tolist()
    text = path.read_text()
    assert text.startswith("format: optical_axis calibration\nversion: 1\n")
    g_arcsec = save_calibration().values[0] / ARCSEC
    assert f"g_arcsec: {g_arcsec:.3f}"[:12] in text
    assert list(tmp_path.glob("folder/*")) == [path]  # nothing half-written is left


BROKEN = [
    ("format: optical_axis calibration", "format: alignment", "expected 'format: optical_axis calibration'"),
    ("version: 1", "version: 9", "version 9 of the calibration: expected 1"),
    ("  focal_length_m:", "  focal_length:", "'values': 'focal_length_m' is missing"),
    ("telescope_id: main", "", "'telescope_id' is missing"),
    ("- - ", "- - -1", "'covariance'"),
]


@pytest.mark.parametrize(("old", "new", "text"), BROKEN)
def test_broken_file_is_refused_by_name(tmp_path: Path, old: str, new: str, text: str) -> None:
    path = tmp_path / "calibration.yaml"
    CALIBRATION_FILE.save(path, save_calibration())
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(BadInput) as error:
        CALIBRATION_FILE.load(path)
    assert str(error.value).startswith(str(path))
    assert text in str(error.value)


def test_a_session_that_starts_from_it_has_its_estimates() -> None:
    filter_ = CalibrationFilter(config())
    state, messages = state_from_prior(filter_, config(), save_calibration(), NOW_NS)
    assert messages == []
    again = prior_from_state(filter_, config(), replace(state, last_beacons_ns=save_calibration().time_ns))
    assert again.values == pytest.approx(save_calibration().values, rel=1e-9, abs=1e-15)
    # Fixed constants have no variance, before and after saving.
    assert again.covariance == pytest.approx(save_calibration().covariance, rel=1e-12)
    # The deformation is not saved, because it will have changed.
    deformation = filter_.model.slices["deformation"]
    assert np.sqrt(np.diagonal(state.covariance)[deformation]) == pytest.approx(20.0 * ARCSEC)
    assert state.mean[deformation].tolist() == [0.0, 0.0, 0.0]
    source = filter_.model.sources.index("saved_calibration")
    rows = filter_.model.state_indices("axes")[:6]
    assert state.covariance_by_source[source][rows, rows] == pytest.approx(np.diagonal(state.covariance)[rows])


def test_an_old_calibration_is_a_wider_prior() -> None:
    filter_ = CalibrationFilter(config())
    young, _ = state_from_prior(filter_, config(), save_calibration(), NOW_NS + 29 * DAY_NS)
    old, messages = state_from_prior(filter_, config(), save_calibration(), NOW_NS + 31 * DAY_NS)
    (message,) = messages
    assert message.startswith("saved calibration is 31.0 d old, more than calibration_max_age_d = 30: the configured")
    rows = filter_.model.state_indices("axes")[:6]
    added = np.diagonal(old.covariance - young.covariance)[rows]
    assert np.sqrt(added) == pytest.approx(30.0 * ARCSEC)
    assert old.mean.tolist() == young.mean.tolist()


def test_one_of_another_theodolite_is_not_used() -> None:
    settings = config(serial="T2")
    state, (message,) = state_from_prior(CalibrationFilter(settings), settings, save_calibration(), NOW_NS)
    assert message == "saved calibration is of theodolite '', configured is 'T2': not used"
    assert state.mean.tolist() == CalibrationFilter(settings).initial_state().mean.tolist()


def test_of_another_telescope_the_axes_are_used() -> None:
    settings = config(telescope__telescope_id="new")
    filter_ = CalibrationFilter(settings)
    state, (message,) = state_from_prior(filter_, settings, save_calibration(), NOW_NS)
    assert "its focal length and parallelism are not used" in message
    assert state.mean[filter_.model.slices["focal_length"]].tolist() == [0.0]
    assert state.mean[filter_.model.slices["axes"]] == pytest.approx(save_calibration().values[:7], abs=1e-15)


def test_services_save_and_load(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    adapter = new_adapter(calibration_file=str(path))
    assert adapter.service("save_alignment", NOW_NS) == (
        False,
        "no light or star was used yet: there is no calibration to save",
    )
    assert not adapter.service("load_alignment", NOW_NS).success
    run_adapter(adapter, session())
    assert adapter.service("save_alignment", NOW_NS).success
    assert adapter.service("reset", NOW_NS).success
    assert adapter.core.state.sighting_count == 0
    assert adapter.service("load_alignment", NOW_NS) == (True, f"calibration loaded from {path}")
    values = dict(zip(SAVED_NAMES, CALIBRATION_FILE.load(path).values, strict=True))
    loaded = calibration_from_state(adapter.core.filter, adapter.core.config, adapter.core.state)
    assert loaded.values[loaded.names.index("c")] == pytest.approx(values["c"], abs=1e-15)
    assert "calibration_file' is empty" in new_adapter().service("save_alignment", NOW_NS).message


def test_the_node_starts_from_the_file_that_is_there(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    CALIBRATION_FILE.save(path, save_calibration())
    dark = tuple(a for a in session() if a.topic != BEACONS)
    with_file = run_adapter(new_adapter(calibration_file=str(path)), dark)
    without_file = run_adapter(new_adapter(), dark)
    # With encoders alone, the pointing is COASTING if a calibration is loaded, otherwise DEGRADED.
    assert with_file.pointings[-1].status == Status.COASTING
    assert without_file.pointings[-1].status == Status.DEGRADED
    traces = [np.trace(np.reshape(run.pointings[-1].rotation_covariance, (3, 3))) for run in (with_file, without_file)]
    assert traces[0] < 0.9 * traces[1]


def test_a_file_that_cannot_be_read_is_set_aside_and_the_start_is_as_configured(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text("nonsense")
    adapter = OpticalAxisAdapter(config(calibration_file=str(path)), FACTORY)
    (warning,) = adapter.start_warnings
    assert "not a calibration" in warning
    assert warning.endswith(f"; set aside as {path}.unreadable; the filter starts as configured")
    assert run_adapter(adapter, session()).pointings[-1].status == Status.VALID


def test_published_calibration_is_the_state() -> None:
    run = fault_free_run()
    message = run.messages("theodolite/calibration")[-1]
    assert list(message.names) == [
        *("g", "h", "c", "I", "beta_x", "beta_y", "focal_length"),
        *("deformation_bow", "deformation_up", "deformation_starboard"),
    ]
    assert list(message.units) == ["rad"] * 6 + ["m"] + ["rad"] * 3
    sigma = np.sqrt(np.diagonal(np.reshape(message.covariance, (10, 10))))
    truth = np.array([*AXES.vector()[:6], FOCAL_LENGTH_M, 0.0, 0.0, 0.0])
    assert np.max(np.abs(np.array(message.values) - truth) / sigma) < 4.0
    assert sigma[6] < 0.3 * 1e-4  # the focal length is known far better than before: 1.9e-5 m a sighting
    assert "g - deformation_up" in message.unobservable
    assert message.sighting_count == 10  # eleven sightings, the last after the report
    # The residuals contain 1 cm of RTK at 2 km, and at most five arcseconds of image and encoder.
    assert 0.3 * ARCSEC < message.residual_rms < 60.0 * ARCSEC
    assert run.adapter.outputs[1].latched


def test_the_budget_adds_up_to_the_pointing() -> None:
    run = fault_free_run()
    budgets = run.messages("theodolite/error_budget")
    assert budgets
    pointings = {(m.header.stamp.sec, m.header.stamp.nanosec): m for m in run.pointings}
    for budget in budgets:
        pointing = pointings[budget.header.stamp.sec, budget.header.stamp.nanosec]
        parts = np.reshape(budget.covariances, (len(budget.sources), 3, 3))
        total = np.reshape(pointing.rotation_covariance, (3, 3))
        assert np.abs(parts.sum(axis=0) - total).max() < 1e-9 * np.abs(total).max()
        assert np.reshape(budget.total, (3, 3)).tolist() == total.tolist()
        assert np.linalg.eigvalsh(parts).min() > -1e-9 * np.trace(total)
    assert {"ship_attitude", "deformation", "axis_errors", "encoder", "rtk", "image"} <= set(budgets[-1].sources)


def test_noise_can_be_changed_while_it_runs_geometry_not() -> None:
    adapter = new_adapter()
    run_adapter(adapter, session())
    before = adapter.core.state
    adapter.set_parameters({"telescope.sigma_m": 5e-6, "gate.probability": 0.99})
    assert adapter.core.state is before
    with pytest.raises(ParameterError, match="cannot be changed while the node runs"):
        adapter.set_parameters({"telescope.focal_length_m": 0.2})
    with pytest.raises(ParameterError, match="out of its range"):
        adapter.set_parameters({"gate.probability": 2.0})


def test_node_reports_itself_and_its_start_calibration(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    absent = new_adapter(calibration_file=str(path))
    assert absent.notices == [f"no calibration at {path} yet: the filter starts as configured"]
    CALIBRATION_FILE.save(path, replace(save_calibration(), time_ns=NOW_NS - 3 * DAY_NS))
    adapter = new_adapter(calibration_file=str(path))
    assert adapter.notices == []
    adapter.tick(NOW_NS)
    assert adapter.notices == [f"calibration {path}, 3.0 d old"]
    line = start_line(adapter, config(calibration_file=str(path)), clock="/demo/clock", black_box="")
    assert line.startswith("beacons: alpha, bravo; ")
    for part in (f"calibration_file: {path}", "clock: /demo/clock", "black box: none", "needs theodolite/encoder"):
        assert part in line, line
