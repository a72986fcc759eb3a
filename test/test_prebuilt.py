"""``make wheels``, and a setup with the compiled parts of these wheels instead of compiling.

The whole procedure, from nothing and with the compilers hidden, is one slow test; the rest is in small folders.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from tools.prebuilt import PREBUILT, find_prebuilt, local_version, package_digests
from tools.wheelhouse import own_target

ROOT = Path(__file__).parents[1]
COMPILERS = ("cc", "c++", "gcc", "g++", "clang", "clang++")


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a package with one compiled module."""
    folder = tmp_path / "src" / "one"
    (folder / "one").mkdir(parents=True)
    (folder / "setup.py").write_text("# setup\n")
    (folder / "one" / "compiled_sum.py").write_text("A = 1\n")
    (folder / "one" / "plain.py").write_text("B = 1\n")
    return folder


def content(package: Path, tools: str = "cython==3") -> str:
    return package_digests([package], tools)[package]


def wheel(root: Path, package: Path, of: str) -> Path:
    """Return a prebuilt wheel, named as by make_wheels, with a compiled module, a Python module and a library."""
    path = root / PREBUILT / f"{package.name}-0.1.0{local_version(of)}-cp311-cp311-linux_x86_64.whl"
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("one/compiled_sum.so", "compiled")
        archive.writestr("one/plain.py", "B = 2\n")
        archive.writestr(f"one-0.1.0{local_version(of)}.data/data/lib/libone.so", "messages")
    return path


def test_the_digest_depends_on_compiled_sources_and_tools(package: Path) -> None:
    before = content(package)
    (package / "one" / "plain.py").write_text("B = 2\n")
    (package / "one" / "compiled_sum.c").write_text("generated\n")
    assert content(package) == before
    assert content(package, "cython==4") != before
    (package / "one" / "compiled_sum.py").write_text("A = 2\n")
    assert content(package) != before


def test_a_wheel_of_the_same_sources_is_used(package: Path, tmp_path: Path) -> None:
    wheel(tmp_path, package, content(package))
    (found,), unfit = find_prebuilt(tmp_path / PREBUILT, {package: content(package)})
    assert unfit == []
    found.unpack(tmp_path / "install")
    assert (package / "one" / "compiled_sum.so").read_text() == "compiled"
    assert (package / "one" / "plain.py").read_text() == "B = 1\n", "sources stay those of the checkout"
    assert not (tmp_path / "install").exists(), "colcon installs the rest"


def test_all_files_that_colcon_installs_are_unpacked_of_messages(package: Path, tmp_path: Path) -> None:
    (package / "CMakeLists.txt").write_text("# messages\n")
    wheel(tmp_path, package, content(package))
    (found,), _ = find_prebuilt(tmp_path / PREBUILT, {package: content(package)})
    found.unpack(tmp_path / "install")
    assert (tmp_path / "install" / "one" / "lib" / "libone.so").read_text() == "messages"
    assert not (package / "one" / "compiled_sum.so").exists()


def test_a_damaged_wheel_is_named(package: Path, tmp_path: Path) -> None:
    path = wheel(tmp_path, package, content(package))
    path.write_bytes(path.read_bytes()[:-40])
    (found,), _ = find_prebuilt(tmp_path / PREBUILT, {package: content(package)})
    with pytest.raises(OSError, match=f"{path.name.split('+')[0]}.* is damaged"):
        found.unpack(tmp_path / "install")


def test_a_wheel_of_other_sources_is_named_and_not_used(package: Path, tmp_path: Path) -> None:
    path = wheel(tmp_path, package, content(package))
    (package / "one" / "compiled_sum.py").write_text("A = 2\n")
    found, (line,) = find_prebuilt(tmp_path / PREBUILT, {package: content(package)})
    assert found == []
    assert path.name in line
    assert "other sources" in line


def test_without_wheels_everything_is_compiled(package: Path, tmp_path: Path) -> None:
    assert find_prebuilt(tmp_path / PREBUILT, {package: content(package)}) == ([], [])


def run(checkout: Path, path: str, *command: str) -> "subprocess.CompletedProcess[str]":
    kept = {name: value for name, value in os.environ.items() if name == "HOME" or name.startswith("PIP_")}
    return subprocess.run(
        command, cwd=checkout, env=kept | {"PATH": path}, capture_output=True, text=True, check=False, timeout=900
    )


@pytest.fixture
def path_without_compilers(tmp_path: Path) -> str:
    """Return a PATH with all programs of the present PATH, except compilers and programs of the virtual environment."""
    folder = tmp_path / "bin"
    folder.mkdir()
    own = str(ROOT / ".venv" / "bin")
    for place in os.environ["PATH"].split(os.pathsep):
        for program in sorted(Path(place).iterdir()) if place != own and Path(place).is_dir() else []:
            hidden = program.name.startswith(("python", "x86_64", "aarch64")) or program.name in COMPILERS
            if not hidden and not os.path.lexists(folder / program.name):
                (folder / program.name).symlink_to(program)
    (folder / "python3").symlink_to(Path(sysconfig.get_config_var("BINDIR")) / f"python3.{sys.version_info.minor}")
    return str(folder)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed: it lists the files to copy")
@pytest.mark.skipif((ROOT / ".venv" / ".ros_prefix").exists(), reason="tried over the wheels alone")
def test_a_checkout_with_prebuilt_wheels_is_set_up_without_a_compiler(
    tmp_path: Path, path_without_compilers: str
) -> None:
    checkout = tmp_path / "checkout"
    make_wheels = [sys.executable, "tools/make_wheels.py", "--out", str(checkout / PREBUILT / own_target())]
    made = subprocess.run(make_wheels, cwd=ROOT, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.split("\0")[:-1]:
        (checkout / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, checkout / name)
    answer = run(checkout, path_without_compilers, "make", "setup")
    if "pip cannot reach the package index" in answer.stderr:
        pytest.skip("pip cannot reach the package index")
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert "compiled parts from 3 prebuilt wheels" in answer.stdout
    replayed = run(
        checkout, path_without_compilers, "./ros2run", "ship_replay", "replay", "bags/demo.mcap", "--out", "out.mcap"
    )
    assert replayed.returncode == 0, replayed.stderr
    assert "ship/attitude 12001" in replayed.stdout
    edited = checkout / "src" / "ship_kernels" / "ship_kernels" / "compiled_stars.py"
    edited.write_text(edited.read_text() + "# edited\n")
    refused = run(checkout, path_without_compilers, "make", "setup")
    assert refused.returncode == 2
    assert "ship_kernels-0.1.0+" in refused.stdout
    (line,) = [line for line in refused.stderr.splitlines() if not line.startswith("make:")]
    assert line.startswith("setup: src/ship_kernels must be compiled, and there is no C++ compiler")
