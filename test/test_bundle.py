"""``make bundle`` and the setup from its tar: in a small checkout with a lock of two wheels, which are built here.

The setup of the whole suite from its bundle without a network is tested by hand (docs/how-to/install.md).
"""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tools.wheelhouse import (
    SUMS,
    WheelsRefused,
    locked_requirements,
    own_target,
    pin_of_requirement,
    pin_of_wheel,
    target,
)

ROOT = Path(__file__).parents[1]
TOOLS = (
    "bundle.py", "generated_c.py", "prebuilt.py", "setup", "setup_build.py", "setup_common.py", "setup_environment.py",
    "setup_wheels.py", "wheelhouse.py",
)  # fmt: skip
WHEEL, ROS_WHEEL = "tiny_part-1.0-py3-none-any.whl", "ros_part-1.0-py3-none-any.whl"
needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


def run(*command: str | Path, cwd: Path, **variables: str) -> "subprocess.CompletedProcess[str]":
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHON", "ROS_DISTRO")}
    words = [str(word) for word in command]
    return subprocess.run(words, cwd=cwd, env=kept | variables, capture_output=True, text=True, check=False)


def build_wheel(path: Path) -> None:
    """Build a wheel with one module, in the format of PEP 427; RECORD may have no hashes."""
    name = path.name.partition("-")[0]
    info = f"{name}-1.0.dist-info"
    files = {
        f"{name}.py": "SIZE = 1\n",
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = "".join(f"{entry},,\n" for entry in (*files, f"{info}/RECORD"))
    with zipfile.ZipFile(path, "w") as archive:
        for entry, text in {**files, f"{info}/RECORD": record}.items():
            archive.writestr(entry, text)


@pytest.fixture(scope="module")
def source_checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a git checkout with the tools and a lock; next to it is index/ with the wheels."""
    folder = tmp_path_factory.mktemp("source") / "suite"
    (folder / "tools").mkdir(parents=True)
    for name in TOOLS:
        shutil.copy(ROOT / "tools" / name, folder / "tools")
    (folder / "requirements.lock").write_text(
        "# two\n# [ros]\nros-part==1.0\n# [build]\nTiny.Part==1.0\n# [python]\nold==1 ; python_version < '3.0'\n"
    )
    (folder / "with space.txt").write_text("tracked\n")
    (folder / ".gitignore").write_text("/out/\n")
    (folder.parent / "index").mkdir()
    for name in (WHEEL, ROS_WHEEL):
        build_wheel(folder.parent / "index" / name)
    named = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false")
    for words in (("init", "-q"), ("add", "-A"), (*named, "commit", "-q", "-m", "all")):
        assert run("git", *words, cwd=folder).returncode == 0
    (folder / "untracked.txt").write_text("stays ashore\n")
    (folder / "with space.txt").write_text("changed\n")
    return folder


def bundle(source_checkout: Path, out: str, *options: str) -> "subprocess.CompletedProcess[str]":
    index = {
        "PIP_NO_INDEX": "1",
        "PIP_FIND_LINKS": str(source_checkout.parent / "index"),
        "PIP_CONFIG_FILE": os.devnull,
    }
    return run(sys.executable, "tools/bundle.py", "--out", out, *options, cwd=source_checkout, **index)


@pytest.fixture(scope="module")
def tar(source_checkout: Path) -> Path:
    made = bundle(source_checkout, "out/first")
    assert made.returncode == 0, made.stderr
    assert "1 files differ from HEAD" in made.stdout
    (path,) = (source_checkout / "out" / "first").iterdir()
    assert path.name.endswith(f"-{own_target()}.tar")
    return path


@pytest.fixture
def unpacked_bundle(tar: Path, tmp_path: Path) -> Path:
    """Return the unpacked bundle."""
    assert run("tar", "--extract", "--file", tar, cwd=tmp_path).returncode == 0
    (folder,) = tmp_path.iterdir()
    return folder


def setup(unpacked_bundle: Path) -> "subprocess.CompletedProcess[str]":
    return run(
        sys.executable, "tools/setup_environment.py", cwd=unpacked_bundle, PIP_INDEX_URL="http://127.0.0.1:9/simple"
    )


def refusal(unpacked_bundle: Path) -> str:
    """Return the one-line error of a setup that created nothing."""
    answer = setup(unpacked_bundle)
    assert answer.returncode == 2
    assert not (unpacked_bundle / ".venv").exists()
    (line,) = answer.stderr.splitlines()
    return line


@pytest.mark.slow
@needs_git
def test_the_tar_holds_the_tracked_files_and_the_wheels(source_checkout: Path, unpacked_bundle: Path) -> None:
    listed = run("git", "ls-tree", "-r", "-z", "--name-only", "HEAD", cwd=source_checkout).stdout.split("\0")[:-1]
    wheels = [f"wheels/{own_target()}/{name}" for name in (SUMS, ROS_WHEEL, WHEEL)]
    there = [str(path.relative_to(unpacked_bundle)) for path in unpacked_bundle.rglob("*") if path.is_file()]
    assert sorted(there) == sorted(listed + wheels)
    assert (unpacked_bundle / "with space.txt").read_text() == "tracked\n"
    assert os.access(unpacked_bundle / "tools" / "setup", os.X_OK)
    checked = run("sha256sum", "--check", "--strict", SUMS, cwd=unpacked_bundle / "wheels" / own_target())
    assert checked.returncode == 0, checked.stderr


@needs_git
def test_the_same_commit_gives_the_same_bytes(source_checkout: Path, tar: Path) -> None:
    (source_checkout.parent / "index" / WHEEL).touch()
    assert bundle(source_checkout, "out/second").returncode == 0
    assert (source_checkout / "out" / "second" / tar.name).read_bytes() == tar.read_bytes()


@needs_git
def test_a_bundle_for_another_python_takes_the_pins_of_that_one(source_checkout: Path) -> None:
    other = "3.12" if sys.version_info[:2] != (3, 12) else "3.11"
    made = bundle(source_checkout, "out/other", "--for", other)
    assert made.returncode == 0, made.stderr
    (path,) = (source_checkout / "out" / "other").iterdir()
    assert f"-python{other}-" in path.name


@needs_git
def test_a_wheel_that_is_not_available_is_one_line_and_no_tar(source_checkout: Path, tmp_path: Path) -> None:
    folder = tmp_path / "suite"
    shutil.copytree(source_checkout, folder, ignore=shutil.ignore_patterns("out"))
    shutil.copytree(source_checkout.parent / "index", tmp_path / "index")
    (tmp_path / "index" / WHEEL).rename(tmp_path / "index" / WHEEL.replace("1.0", "1.1"))
    made = bundle(folder, "out")
    assert made.returncode == 2
    (line,) = made.stderr.splitlines()
    assert "tiny-part==1.0" in line
    assert list((folder / "out").iterdir()) == []


@pytest.mark.slow
@needs_git
def test_setup_installs_only_from_the_wheels(unpacked_bundle: Path) -> None:
    """The configuration of pip has no effect: an index without a server is never requested.

    The build after the installation needs colcon and fails, which ends the installations in progress. Both wheels are
    in the group for which the build waits.
    """
    answer = setup(unpacked_bundle)
    assert f"the wheels of wheels/{own_target()} are complete: no network is used" in answer.stdout
    assert "colcon build failed" in answer.stderr
    log = (unpacked_bundle / ".venv" / "setup.log").read_text()
    (installed,) = (line for line in log.replace("_", "-").splitlines() if line.startswith("Successfully installed"))
    assert {"ros-part-1.0", "tiny-part-1.0"} <= set(installed.split())
    assert "127.0.0.1" not in log


@needs_git
def test_over_a_ros_installation_its_wheels_are_left_out(unpacked_bundle: Path) -> None:
    code = (
        "from setup_wheels import lines_to_install; from wheelhouse import locked_requirements;"
        "lock = locked_requirements(open('../requirements.lock').read());"
        "print(*lines_to_install(lock, ('ros', 'build', 'python'), '/opt/ros/jazzy'), sep='\\n')"
    )
    printed = run(sys.executable, "-c", code, cwd=unpacked_bundle / "tools").stdout.splitlines()
    assert printed == ["Tiny.Part==1.0", "old==1 ; python_version < '3.0'"]


@needs_git
def test_a_damaged_wheel_is_named(unpacked_bundle: Path) -> None:
    path = unpacked_bundle / "wheels" / own_target() / WHEEL
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert f"{WHEEL} is damaged" in refusal(unpacked_bundle)


@needs_git
def test_a_missing_wheel_is_named(unpacked_bundle: Path) -> None:
    (unpacked_bundle / "wheels" / own_target() / WHEEL).unlink()
    assert f"{WHEEL} is missing" in refusal(unpacked_bundle)


@needs_git
def test_wheels_for_another_lock_are_refused(unpacked_bundle: Path) -> None:
    with (unpacked_bundle / "requirements.lock").open("a") as lock:
        lock.write("more==1\n")
    assert "made for another requirements.lock" in refusal(unpacked_bundle)


@needs_git
@pytest.mark.parametrize(
    ("keep", "complaint"),
    [(0, "is missing or does not begin with requirements.lock"), (2, "has no wheel of Tiny.Part==1.0")],
)
def test_sums_cut_short_are_refused(unpacked_bundle: Path, keep: int, complaint: str) -> None:
    path = unpacked_bundle / "wheels" / own_target() / SUMS
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:keep]))
    assert complaint in refusal(unpacked_bundle)


@needs_git
def test_a_line_of_the_sums_that_names_a_file_elsewhere_is_refused(unpacked_bundle: Path) -> None:
    path = unpacked_bundle / "wheels" / own_target() / SUMS
    path.write_text(path.read_text() + "0" * 64 + "  ../elsewhere.whl\n")
    assert f"{SUMS} line 4" in refusal(unpacked_bundle)


@needs_git
def test_wheels_for_another_python_are_refused(unpacked_bundle: Path) -> None:
    (unpacked_bundle / "wheels" / own_target()).rename(unpacked_bundle / "wheels" / target("3.9", "riscv64"))
    line = refusal(unpacked_bundle)
    assert "are for python3.9-riscv64" in line
    assert own_target() in line


@pytest.mark.parametrize(("given", "chosen"), [({}, "python3.12"), ({"PYTHON": "python3.10"}, "python3.10")])
def test_the_python_of_the_wheels_comes_first(tmp_path: Path, given: dict[str, str], chosen: str) -> None:
    """Several Pythons are in the path; PYTHON has priority over all.

    These Pythons print their names and pass checks.
    """
    (tmp_path / "wheels" / target("3.12", "x86_64")).mkdir(parents=True)
    (tmp_path / "tools").mkdir()
    shutil.copy(ROOT / "tools" / "setup", tmp_path / "tools")
    for name in ("python3", "python3.10", "python3.12"):
        (tmp_path / name).write_text('#!/bin/sh\n[ "$1" = -c ] || basename "$0"\n')
        (tmp_path / name).chmod(0o755)
    answer = run("tools/setup", cwd=tmp_path, PATH=f"{tmp_path}:{os.environ['PATH']}", **given)
    assert answer.stdout.split() == [chosen]


def test_pins_and_wheels_are_compared_by_the_names_of_an_index() -> None:
    """Names are normalised as in PEP 503, and file names are escaped as in PEP 427."""
    assert pin_of_requirement("Ruamel.Yaml==0.19.1 ; python_version < '3.11'") == "ruamel-yaml==0.19.1"
    assert pin_of_wheel("ruamel_yaml-0.19.1-py3-none-any.whl") == "ruamel-yaml==0.19.1"


def test_a_lock_is_read_by_its_sections() -> None:
    lock = "# Head.\n# [ros] ROS\nros-a==1\n\n# [all] more\nb==2 ; python_version >= '3.11'\n"
    assert locked_requirements(lock) == {
        "ros": ["ros-a==1"],
        "build": [],
        "python": [],
        "all": ["b==2 ; python_version >= '3.11'"],
    }


@pytest.mark.parametrize(
    ("lock", "complaint"),
    [
        ("a==1\n# [ros]\n", "line 1: 'a==1' is before the first section"),
        ("# [ros]\na==1\n# [most]\n", r"line 3: section \[most\] is not one of ros, build, python, all"),
    ],
)
def test_a_lock_whose_sections_are_wrong_is_refused(lock: str, complaint: str) -> None:
    with pytest.raises(WheelsRefused, match=complaint):
        locked_requirements(lock)
