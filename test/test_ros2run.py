"""./ros2run, which replaces ``ros2 run`` if ros2cli is not installed."""

import shutil
import subprocess
from pathlib import Path

import pytest

from ship_bags.commands.moved import NEW_PACKAGE

ROOT = Path(__file__).parents[1]


def ros2run(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([root / "ros2run", *arguments], capture_output=True, text=True, timeout=60, check=False)


def test_alone_it_lists_packages_and_their_executables() -> None:
    alone = ros2run(ROOT)
    assert (alone.returncode, alone.stderr) == (0, "")
    usage, _, *lines = alone.stdout.splitlines()
    assert usage.startswith("usage: ros2run PACKAGE EXECUTABLE")
    listed = dict(line.split(": ") for line in lines)
    assert {"ship_attitude", "star_attitude"} <= set(listed["ship_attitude_star"].split())
    assert {"replay", "check_config"} <= set(listed["ship_replay"].split())
    assert {"play", "record", "import_nmea"} <= set(listed["ship_bags"].split())
    assert "simulate" in listed["ship_simulation"].split()
    assert "optical_axis" in listed["theodolite_calib"].split()
    assert "ship_geometry" not in listed
    assert ros2run(ROOT, "--help").stdout == alone.stdout


def test_a_package_alone_lists_its_executables() -> None:
    for arguments in (["ship_bags"], ["ship_bags", ""]):
        run = ros2run(ROOT, *arguments)
        assert (run.returncode, run.stdout) == (2, "")
        listed = "export import_nmea info play record"
        assert run.stderr == f"ros2run: name an executable of package 'ship_bags': {listed}\n"
    wrong = ros2run(ROOT, "ship_bags", "rekord")
    assert wrong.stderr == f"ros2run: no executable 'rekord' in package 'ship_bags'; there are: {listed}\n"


def test_before_the_first_build_the_list_explains_how_to_build(tmp_path: Path) -> None:
    shutil.copy(ROOT / "ros2run", tmp_path)
    alone = ros2run(tmp_path)
    assert (alone.returncode, alone.stderr) == (0, "")
    assert alone.stdout.splitlines()[-1].startswith("nothing is built yet: 'make setup'")
    assert [path.name for path in tmp_path.iterdir()] == ["ros2run"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old_package", "name"),
    [
        ("ship_attitude_star", "layout_study"),
        ("theodolite_calib", "design_study"),
        ("theodolite_calib", "fit_axes"),
        ("ship_replay", "axis_sightings"),
        ("ship_replay", "calibrate_installation"),
        ("ship_replay", "campaign"),
        ("ship_replay", "identify_noise"),
    ],
)
def test_an_executable_that_moved_is_named_in_its_old_package(old_package: str, name: str) -> None:
    run = ros2run(ROOT, old_package, name, "--help")
    assert run.returncode == 2
    assert run.stderr == f"{name} has moved from {old_package} to {NEW_PACKAGE}: ./ros2run {NEW_PACKAGE} {name}\n"
    assert ros2run(ROOT, NEW_PACKAGE, name, "--help").stdout.startswith(f"usage: ./ros2run {NEW_PACKAGE} {name}\n")
