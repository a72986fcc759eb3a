"""Each package separately: its folder has all that a workspace, a release or an installer of one package needs."""

import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import pytest

from tools.dependencies import SRC, declared_keys, packages, required_distributions
from tools.generated_c import generate_c

ROOT = Path(__file__).parents[1]
IN_PYTHON = [package for package in packages() if (SRC / package / "setup.py").exists()]
BUILT = shutil.ignore_patterns("build", "*.egg-info", "__pycache__", "*.so", "compiled_*.c", "compiled_*.sha256")
NO_CYTHON = "raise ImportError\n"
OLD_CYTHON = '__version__ = "3.0.8"\n'


@pytest.mark.parametrize("package", packages())
def test_a_package_has_its_own_documents(package: str) -> None:
    folder = SRC / package
    version = ET.parse(folder / "package.xml").getroot().findtext("version")
    assert (folder / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    title, *entries = re.findall(r"^([^\s^*-].*)\n(?:\^+|-+)$", (folder / "CHANGELOG.rst").read_text(), re.MULTILINE)
    assert title == f"Changelog for package {package}"
    assert entries[0] == "Forthcoming" or entries[0].startswith(version)
    assert declared_keys(package, "url")


@pytest.mark.parametrize("package", IN_PYTHON)
def test_a_package_can_be_built_and_typed_by_others(package: str) -> None:
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 reads no TOML")
    folder = SRC / package
    system = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]
    is_compiled = any((folder / package).rglob("compiled_*.py"))
    assert system["build-backend"] == "setuptools.build_meta"
    assert [re.split(r"\W", need)[0] for need in system["requires"]] == ["setuptools", *["Cython"] * is_compiled]
    assert (folder / package / "py.typed").exists()
    assert re.search(r'package_data={package_name: \["py.typed"', (folder / "setup.py").read_text(encoding="utf-8"))
    assert "python3-pytest-xdist" in declared_keys(package, "test_depend")
    siblings = set(packages())
    assert required_distributions(package) & siblings == declared_keys(package, "depend") & siblings


@pytest.mark.parametrize("package", packages())
def test_no_file_of_a_package_links_outside_it(package: str) -> None:
    for path in (SRC / package).rglob("*"):
        if path.is_symlink() and "build" not in path.parts:
            assert path.resolve().is_relative_to(SRC / package), path


def build(package: Path, cython: str | None = None) -> "subprocess.CompletedProcess[str]":
    """Build a wheel of a package; the code ``cython``, if given, takes the place of the installed Cython."""
    environment = {name: value for name, value in os.environ.items() if name != "SHIP_SUITE_IS_COMPILED"}
    if cython is not None:
        (package.parent / "hidden" / "Cython").mkdir(parents=True)
        (package.parent / "hidden" / "Cython" / "__init__.py").write_text(cython)
        (package.parent / "hidden" / "Cython" / "Build.py").write_text("cythonize = None\n")
        environment["PYTHONPATH"] = f"{package.parent / 'hidden'}:{environment['PYTHONPATH']}"
    command = [sys.executable, "setup.py", "-q", "bdist_wheel", "--dist-dir", "made"]
    return subprocess.run(command, cwd=package, env=environment, capture_output=True, text=True, check=False)


def test_the_package_of_launch_and_parameter_files_is_built_alone(tmp_path: Path) -> None:
    package = tmp_path / "ship_bringup"
    shutil.copytree(SRC / "ship_bringup", package, symlinks=True, ignore=BUILT)
    answer = build(package)
    assert answer.returncode == 0, answer.stderr
    (wheel,) = (package / "made").iterdir()
    with zipfile.ZipFile(wheel) as archive:
        inside = {name.partition("/data/")[2]: archive.read(name) for name in archive.namelist()}
    for path in (SRC / "ship_bringup" / "config").iterdir():
        assert inside[f"share/ship_bringup/config/{path.name}"] == path.read_bytes()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Return the sources of the package with the compiled modules, in a folder src/."""
    package = tmp_path / "src" / "ship_kernels"
    shutil.copytree(SRC / package.name, package, ignore=BUILT)
    return package


@pytest.mark.parametrize(("cython", "why"), [(NO_CYTHON, "none is here"), (OLD_CYTHON, "3.0.8 is here")])
def test_a_checkout_without_cython_ends_in_one_line(checkout: Path, cython: str, why: str) -> None:
    answer = build(checkout, cython)
    assert answer.returncode == 1
    (line,) = [line for line in answer.stderr.splitlines() if line and not line.startswith("warning: build_py: byte")]
    assert line.startswith(f"ship_kernels: Cython 3.1 or newer is needed and {why}: install it with pip")


@pytest.mark.slow
@pytest.mark.parametrize("cython", [NO_CYTHON, OLD_CYTHON], ids=["none", "3.0.8"])
def test_a_release_is_compiled_from_its_c_without_cython(checkout: Path, cython: str) -> None:
    made = generate_c(checkout.parent)
    assert {"compiled_sources.sha256", "compiled_stars.c"} <= {path.name for path in made}
    answer = build(checkout, cython)
    assert answer.returncode == 0, answer.stderr
    (wheel,) = (checkout / "made").iterdir()
    with zipfile.ZipFile(wheel) as archive:
        assert any(name.startswith("ship_kernels/compiled_stars.") for name in archive.namelist())


def test_c_of_other_sources_is_not_taken(checkout: Path) -> None:
    generate_c(checkout.parent)
    source = checkout / "ship_kernels" / "compiled_stars.py"
    source.write_text(source.read_text(encoding="utf-8") + "# edited\n", encoding="utf-8")
    answer = build(checkout, NO_CYTHON)
    assert answer.returncode == 1
    assert "none is here" in answer.stderr


def test_pytest_of_ubuntu_takes_the_settings_without_any_plugin(pytestconfig: pytest.Config) -> None:
    """``colcon test`` runs pytest 7.4 in a package's folder, with the settings of the repository."""
    assert pytestconfig.getini("minversion").startswith("7.4")
    assert {line.partition(":")[0] for line in pytestconfig.getini("markers")} >= {"live", "slow", "xdist_group"}
    assert "xdist_group" in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
