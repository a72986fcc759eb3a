"""A saved alignment is the prior of the next voyage; a bad file is named and not used."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ship_attitude_star.adapters.alignment_file import ALIGNMENT_FILE
from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ship_attitude.alignment import current_alignment
from ship_bags.errors import BadInput
from ship_estimation.time_order.outcome import Status
from ship_geometry.rotations import ARCSEC, log_rotation
from ship_node.saved_files.saved_document import RecordingFiles
from ship_node.saved_files.saved_start import less_certain_quantity
from ship_testing.adapter_runs import FACTORY, START_NS
from ship_testing.small_voyage import FORE, INS, config, fault_free_run, new_adapter, run_adapter, voyage

DAY_NS = 86_400 * 10**9
END_NS = START_NS + 60 * 10**9


@pytest.fixture
def saved_path(tmp_path: Path) -> Path:
    """Alignment file of the voyage."""
    path = tmp_path / "alignment.yaml"
    ALIGNMENT_FILE.save(path, fault_free_run().adapter.core.alignment_to_save())
    return path


def start_adapter(path: Path, now_ns: int = START_NS, **changes: Any) -> ShipAttitudeAdapter:
    """Return an adapter started with an alignment file and without inputs."""
    adapter = new_adapter(alignment_file=str(path), **changes)
    adapter.tick(now_ns)
    return adapter


def sigma_of(adapter: ShipAttitudeAdapter) -> dict[str, float]:
    alignment = current_alignment(adapter.core.filter, adapter.core.config, adapter.core.state)
    return dict(zip(alignment.names, np.sqrt(np.diagonal(alignment.covariance)).tolist(), strict=True))


def value_of(adapter: ShipAttitudeAdapter) -> dict[str, float]:
    alignment = current_alignment(adapter.core.filter, adapter.core.config, adapter.core.state)
    return dict(zip(alignment.names, alignment.values.tolist(), strict=True))


def alignment_text(adapter: ShipAttitudeAdapter, now_ns: int) -> tuple[int, str]:
    """Return level and text of the alignment diagnostic."""
    published = adapter.tick(now_ns + 2 * 10**9)
    (report,) = [message for topic, message in published if topic == "/diagnostics"]
    (status,) = [status for status in report.status if status.name == "ship_attitude: alignment"]
    return status.level, status.message


def test_saved_alignment_is_the_prior_of_the_next_voyage(saved_path: Path) -> None:
    before, configured, now = (
        fault_free_run().adapter,
        start_adapter(saved_path.with_name("none")),
        start_adapter(saved_path),
    )
    assert alignment_text(now, START_NS) == (0, "as configured or loaded")
    for name in ("ins.time_offset", *(f"star.{s}.{a}" for s in ("fore", "starboard") for a in ("elevation", "roll"))):
        assert value_of(now)[name] == pytest.approx(value_of(before)[name], abs=1e-12)
        assert sigma_of(now)[name] == pytest.approx(sigma_of(before)[name], rel=1e-6)
        assert sigma_of(now)[name] < sigma_of(configured)[name]
    # The configured sigma is 5 ms; a swell of 2 to 4° makes the offset observable to a few tenths of a millisecond.
    assert sigma_of(now)["ins.time_offset"] < 0.2 * sigma_of(configured)["ins.time_offset"]
    # INS errors are not loaded, because they belong to another voyage.
    assert value_of(now)["ins.up"] == 0.0
    assert sigma_of(now)["ins.up"] == pytest.approx(72.0 * ARCSEC)


def test_the_next_voyage_starts_closer_and_accepts_its_stars(saved_path: Path) -> None:
    fresh, primed = (
        run_adapter(new_adapter(alignment_file=str(p)), voyage(1.0)) for p in (saved_path.with_name("none"), saved_path)
    )
    fresh_last, primed_last = (run.messages("ship/attitude")[-1] for run in (fresh, primed))
    assert np.all(np.diagonal(np.reshape(primed_last.covariance - fresh_last.covariance, (3, 3))) < 0.0)
    assert primed.health(FORE).rejected == 0
    budget = primed.messages("ship/error_budget")[-1]
    part = np.reshape(budget.covariances, (-1, 3, 3))[list(budget.sources).index("saved_alignment")]
    assert part.trace() > 0.0


def test_a_file_keeps_every_number(saved_path: Path) -> None:
    prior, read = fault_free_run().adapter.core.alignment_to_save(), ALIGNMENT_FILE.load(saved_path)
    assert (read.time_ns, read.serials, read.names) == (prior.time_ns, {"fore": "F1", "starboard": "S1"}, prior.names)
    assert read.time_offsets_s == prior.time_offsets_s
    assert np.array_equal(read.covariance, prior.covariance)
    for name, rotation_dv in prior.rotations_dv.items():
        # The conversion of angles to degrees and back costs a few 1e-16 rad.
        assert np.allclose(log_rotation(rotation_dv.T @ read.rotations_dv[name]), 0.0, atol=2e-15)
    assert list(saved_path.parent.iterdir()) == [saved_path]  # no temporary file remains


def test_another_serial_number_keeps_the_configured_prior(saved_path: Path) -> None:
    configured = start_adapter(saved_path.with_name("none"))
    now = start_adapter(saved_path, star_sensors__fore__serial="F2")
    for axis in ("azimuth", "elevation", "roll"):
        assert value_of(now)[f"star.fore.{axis}"] == value_of(configured)[f"star.fore.{axis}"]
        assert sigma_of(now)[f"star.fore.{axis}"] == sigma_of(configured)[f"star.fore.{axis}"]
        assert sigma_of(now)[f"star.starboard.{axis}"] < sigma_of(configured)[f"star.starboard.{axis}"]
    level, text = alignment_text(now, START_NS)
    assert level == 1
    assert all(word in text for word in ("'fore'", "'F1'", "'F2'", "configured prior"))


def test_to_an_old_file_the_configured_uncertainty_is_added(saved_path: Path) -> None:
    now_ns = START_NS + 31 * DAY_NS
    configured = start_adapter(saved_path.with_name("none"))
    old, young = start_adapter(saved_path, now_ns), start_adapter(saved_path, now_ns - 2 * DAY_NS)
    for name in ("ins.time_offset", "star.fore.azimuth", "star.fore.elevation", "star.fore.roll"):
        assert value_of(old)[name] == value_of(young)[name] != value_of(configured)[name]
        assert sigma_of(old)[name] > sigma_of(configured)[name] > sigma_of(young)[name]
    level, text = alignment_text(old, now_ns)
    assert level == 1
    assert "31.0 d old" in text
    assert "alignment_max_age_d = 30" in text
    assert alignment_text(young, now_ns - 2 * DAY_NS)[0] == 0


def test_the_random_walk_of_the_time_between_is_added(saved_path: Path) -> None:
    walk = {"star_sensors__fore__installation_walk_up_arcsec_per_sqrt_h": 1.0}
    sigma = [
        sigma_of(start_adapter(saved_path, START_NS + 25 * 3600 * 10**9, **w))["star.fore.azimuth"] for w in ({}, walk)
    ]
    # At elevation 45° a rotation about the sensor's up axis changes the azimuth by the rotation divided by cos 45°. The
    # random walk is 1″ per root hour, the time 25 h.
    added = math.sqrt(sigma[1] ** 2 - sigma[0] ** 2)
    assert added == pytest.approx(5.0 * ARCSEC * math.sqrt(2.0), rel=1e-3)


def test_sensors_missing_in_the_file_or_in_the_configuration(saved_path: Path) -> None:
    aft = {"azimuth_deg": 180.0, "elevation_deg": 45.0}
    now = start_adapter(
        saved_path, star_sensors={"fore": {"azimuth_deg": 0.0, "elevation_deg": 45.0, "serial": "F1"}, "aft": aft}
    )
    assert sigma_of(now)["star.aft.elevation"] == pytest.approx(ARCSEC)
    assert sigma_of(now)["star.fore.elevation"] < ARCSEC
    assert "star.starboard.elevation" not in sigma_of(now)


def document(saved_path: Path) -> dict[str, Any]:
    return yaml.safe_load(saved_path.read_text(encoding="utf-8"))


def remove_key(*keys: str) -> Any:
    def change(content: dict[str, Any]) -> None:
        for key in keys[:-1]:
            content = content[key]
        del content[keys[-1]]

    return change


def with_value(value: Any, *keys: Any) -> Any:
    def change(content: dict[str, Any]) -> None:
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


BROKEN = [
    (with_value("other", "format"), "expected 'format: ship_attitude alignment'"),
    (with_value(2, "version"), "version 2"),
    (remove_key("covariance"), "'covariance' is missing"),
    (remove_key("installation", "star.fore"), "star.fore"),
    (remove_key("installation", "star.fore", "roll_deg"), "roll_deg"),
    (remove_key("time_offset_s", "ins.time_offset"), "ins.time_offset"),
    (with_value([1, 2], "covariance_of"), "covariance_of"),
    (with_value(["star.fore"], "installation"), "installation"),
    (with_value(3.0, "serials"), "serials"),
    (with_value("late", "time_ns"), "time_ns"),
    (with_value(math.nan, "installation", "star.fore", "azimuth_deg"), "star.fore"),
    (with_value(math.inf, "time_offset_s", "ins.time_offset"), "ins.time_offset"),
    (with_value([[0.0]], "covariance"), "shape (1, 1)"),
    (with_value("x", "covariance", 0, 0), "could not convert"),
    (with_value(math.nan, "covariance", 0, 0), "finite"),
    (with_value(-1.0, "covariance", 0, 0), "positive semidefinite"),
    (with_value(1.0, "covariance", 0, 1), "symmetric"),
]


@pytest.mark.parametrize(("change", "text"), BROKEN, ids=[text for _, text in BROKEN])
def test_a_broken_file_is_set_aside_and_named_at_the_start(saved_path: Path, change: Any, text: str) -> None:
    content = document(saved_path)
    change(content)
    saved_path.write_text(yaml.safe_dump(content), encoding="utf-8")
    *_, warning = new_adapter(alignment_file=str(saved_path)).start_warnings
    assert warning.startswith(f"{saved_path}: ")
    assert text in warning
    assert warning.endswith(f"; set aside as {saved_path}.unreadable; the filter starts as configured")
    assert "\n" not in warning
    assert not saved_path.exists()


@pytest.mark.parametrize(
    "content", [b"", b"- 1\n- 2\n", b"a: [1\nb", b"\xff\xfe\x00", b"x: !!python/object:os.system {}\n"]
)
def test_a_file_without_alignment_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "alignment.yaml"
    path.write_bytes(content)
    adapter = new_adapter(alignment_file=str(path))
    assert "alignment" in adapter.start_warnings[-1]
    attitudes = run_adapter(adapter, voyage()).messages("ship/attitude")
    assert (attitudes[0].status, attitudes[-1].status) == (Status.DEGRADED, Status.VALID)
    level, text = alignment_text(adapter, END_NS)
    assert (level, f"set aside as {path}.unreadable" in text) == (1, True)
    assert path.with_name("alignment.yaml.unreadable").read_bytes() == content
    assert adapter.service("save_alignment", END_NS).success
    assert alignment_text(adapter, END_NS + 10 * 10**9) == (0, "as configured or loaded")


def test_a_directory_in_place_of_the_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot be read"):
        new_adapter(alignment_file=str(tmp_path))


def test_without_a_file_the_node_starts_as_configured(tmp_path: Path) -> None:
    run = run_adapter(new_adapter(alignment_file=str(tmp_path / "none.yaml")), voyage())
    assert run.results() == fault_free_run().results()


def test_the_services_save_and_load(tmp_path: Path) -> None:
    path = tmp_path / "ship" / "alignment.yaml"
    run = run_adapter(new_adapter(alignment_file=str(path)), voyage())
    answer = run.adapter.service("save_alignment", run.now_ns)
    assert answer.success
    assert str(path) in answer.message
    assert ALIGNMENT_FILE.load(path).time_ns == run.adapter.core.state.time_ns

    later = ShipAttitudeAdapter(config(), FACTORY)
    assert not later.service("load_alignment", START_NS).success
    assert "alignment_file" in later.service("save_alignment", START_NS).message

    path.write_text("nonsense", encoding="utf-8")
    before = run.state()
    refused = run.adapter.service("load_alignment", run.now_ns)
    assert (refused.success, str(path) in refused.message) == (False, True)
    assert run.state() == before
    assert run.adapter.service("save_alignment", run.now_ns).success
    loaded = run.adapter.service("load_alignment", run.now_ns)
    assert loaded.success
    assert sigma_of(run.adapter)["ins.time_offset"] < 0.001
    assert sigma_of(run.adapter)["ins.up"] == pytest.approx(72.0 * ARCSEC)


def test_a_path_that_cannot_be_written_is_named_and_the_node_continues(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    path = tmp_path / "file" / "alignment.yaml"
    adapter = run_adapter(new_adapter(alignment_file=str(path)), voyage()).adapter
    answer = adapter.service("save_alignment", START_NS)
    assert not answer.success
    assert str(path) in answer.message


def test_after_a_jump_of_the_clock_the_saved_alignment_is_the_start_again(saved_path: Path) -> None:
    run = run_adapter(new_adapter(alignment_file=str(saved_path)), voyage(1.0))
    run.adapter.clock_jumped_back(START_NS)
    again = run_adapter(run.adapter, voyage(1.0))
    assert again.state() == saved_run_state(saved_path)
    assert again.results() == run_adapter(new_adapter(alignment_file=str(saved_path)), voyage(1.0)).results()


def saved_run_state(saved_path: Path) -> Any:
    return run_adapter(new_adapter(alignment_file=str(saved_path)), voyage(1.0)).state()


def test_a_voyage_without_stars_does_not_make_the_alignment_younger_or_older(saved_path: Path) -> None:
    """An alignment saved before the first star of a voyage equals the loaded alignment."""
    adapter, before = start_adapter(saved_path, START_NS + DAY_NS), document(saved_path)
    assert adapter.service("save_alignment", START_NS + DAY_NS).success
    after = document(saved_path)
    assert after["time_ns"] == before["time_ns"]
    assert after["covariance"] == before["covariance"]


def test_without_measurements_nothing_is_saved(tmp_path: Path) -> None:
    adapter = start_adapter(tmp_path / "none.yaml")
    answer = adapter.service("save_alignment", START_NS)
    assert (answer.success, "no star" in answer.message) == (False, True)
    assert list(tmp_path.iterdir()) == []


def autosaving_adapter(path: Path, period_s: float = 1.0, **changes: Any) -> ShipAttitudeAdapter:
    return new_adapter(alignment_file=str(path), alignment_autosave_s=period_s, **changes)


def save_smaller_covariance(path: Path) -> bytes:
    """Save an alignment whose sigmas are a hundredth of those after the voyage."""
    prior = fault_free_run().adapter.core.alignment_to_save()
    return ALIGNMENT_FILE.save(path, dataclasses.replace(prior, covariance=prior.covariance * 1e-4))


def test_a_node_saves_by_itself_once_a_period_what_the_service_would_save(tmp_path: Path) -> None:
    path, requested = tmp_path / "alignment.yaml", tmp_path / "by_service.yaml"
    files = CountedFiles()
    adapter = ShipAttitudeAdapter(config(alignment_file=str(path), alignment_autosave_s=1.0), FACTORY, files)
    run = run_adapter(adapter, voyage())
    # The ticks last five seconds; the first tick starts the first period of 1 s.
    assert [use.path for use in files.uses if use.written] == [str(path)] * 4
    until = [arrival for arrival in voyage() if arrival.receive_ns <= files.last_written_ns]
    assert len(until) > 100
    assert ALIGNMENT_FILE.load(path).time_ns < run.adapter.core.state.time_ns
    ALIGNMENT_FILE.save(requested, run_adapter(new_adapter(), until).adapter.core.alignment_to_save())
    assert requested.read_bytes() == path.read_bytes()
    # The results are those without automatic saving.
    assert run.results() == fault_free_run().results()


class CountedFiles(RecordingFiles):
    """Record the uses of files, and compute the time of the last write."""

    last_written_ns = 0

    def write(self, path: Path, content: bytes) -> None:
        super().write(path, content)
        period_ns = 1_000_000_000
        first = next(iter(voyage())).receive_ns // 100_000_000 * 100_000_000 + 100_000_000
        self.last_written_ns = first + len([use for use in self.uses if use.written]) * period_ns


def test_nothing_is_saved_without_a_file_or_with_a_period_of_zero(tmp_path: Path) -> None:
    path = tmp_path / "alignment.yaml"
    run_adapter(autosaving_adapter(path, 0.0), voyage())
    run = run_adapter(new_adapter(alignment_autosave_s=1.0), voyage())
    assert not list(tmp_path.iterdir())
    assert run.adapter.notices == []


def test_an_attitude_that_no_star_has_aligned_is_not_saved(tmp_path: Path) -> None:
    path = tmp_path / "alignment.yaml"
    run_adapter(autosaving_adapter(path), [arrival for arrival in voyage() if arrival.topic == INS])
    assert not path.exists()


def test_a_more_accurate_file_is_kept_and_the_reason_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "alignment.yaml"
    adapter = autosaving_adapter(path)  # The more accurate file is written after the node's start.
    better = save_smaller_covariance(path)
    run = run_adapter(adapter, voyage())
    assert path.read_bytes() == better
    (notice,) = [text for text in run.adapter.notices if "not saved automatically" in text]
    assert str(path) in notice
    assert "; ~/save_alignment replaces it" in notice
    level, text = alignment_text(run.adapter, run.now_ns)
    assert (level, notice in text) == (1, True)
    assert run.adapter.service("save_alignment", run.now_ns).success
    assert path.read_bytes() != better


def test_the_file_of_the_start_may_be_replaced(tmp_path: Path) -> None:
    path = tmp_path / "alignment.yaml"
    save_smaller_covariance(path)
    before_ns = ALIGNMENT_FILE.load(path).time_ns
    run_adapter(autosaving_adapter(path), voyage(8.0))
    assert ALIGNMENT_FILE.load(path).time_ns > before_ns


def test_after_a_reset_the_better_file_of_before_stays(tmp_path: Path) -> None:
    path = tmp_path / "alignment.yaml"
    adapter = run_adapter(autosaving_adapter(path), voyage()).adapter
    learned = path.read_bytes()
    adapter.service("reset", START_NS)
    run_adapter(adapter, voyage(2.0))
    assert path.read_bytes() == learned


@pytest.mark.parametrize("changes", [{"serials": {"fore": "F2"}}, {"serials": {"fore": "F1", "starboard": "S7"}}])
def test_the_alignment_of_another_sensor_is_not_lost(tmp_path: Path, changes: dict[str, Any]) -> None:
    path, prior = tmp_path / "alignment.yaml", fault_free_run().adapter.core.alignment_to_save()
    foreign = ALIGNMENT_FILE.save(path, dataclasses.replace(prior, covariance=prior.covariance * 1e4, **changes))
    run = run_adapter(autosaving_adapter(path), voyage())
    assert path.read_bytes() == foreign
    assert any("which is not configured here" in text for text in run.adapter.notices)


def test_a_state_that_is_not_finite_is_not_saved(tmp_path: Path) -> None:
    prior = fault_free_run().adapter.core.alignment_to_save()
    broken = dataclasses.replace(prior, covariance=prior.covariance * np.nan)
    assert less_certain_quantity(broken, prior)
    assert less_certain_quantity(prior, prior) == ""
    assert less_certain_quantity(prior, dataclasses.replace(prior, covariance=prior.covariance / 1.3)).startswith(
        "a smaller sigma of"
    )


def test_a_full_disk_is_reported_once_and_again_when_it_recovers(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "alignment.yaml"
    (tmp_path / "folder").write_text("", encoding="utf-8")
    adapter = autosaving_adapter(path)
    halves = [a for a in voyage() if a.receive_ns < START_NS + 3 * 10**9], voyage()
    run_adapter(adapter, halves[0])
    assert sum("cannot be written" in text for text in adapter.notices) == 1
    (tmp_path / "folder").unlink()
    run_adapter(adapter, halves[1][len(halves[0]) :])
    assert path.exists()
    assert adapter.notices[-1] == f"alignment is saved automatically again to {path}"
