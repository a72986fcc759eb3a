"""The wrapped functions are scipy's own, for either order of import."""

import subprocess
import sys
from pathlib import Path

import pytest

SAME = "assert all(getattr(lapack, n) is getattr(scipy.linalg.lapack, n) for n in ('dgesdd', 'dposv', 'dpotrf'))"


@pytest.mark.parametrize(
    "imports",
    [
        "from ship_geometry import lapack; import scipy.linalg.lapack",
        "import scipy.linalg.lapack; from ship_geometry import lapack",
    ],
)
def test_functions_are_those_of_scipy(imports: str, tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", f"{imports}; {SAME}"], cwd=tmp_path, check=True, timeout=60)


def test_no_other_module_of_scipy_is_imported(tmp_path: Path) -> None:
    check = "import sys; from ship_geometry import lapack; assert 'scipy' not in sys.modules"
    subprocess.run([sys.executable, "-c", check], cwd=tmp_path, check=True, timeout=60)


def test_lapack_and_erfa_are_imported_on_first_use(tmp_path: Path) -> None:
    check = """
import sys
from ship_geometry import lapack, wahba
from ship_geometry.earth import geodetic, late_erfa, star_directions
assert "erfa" not in sys.modules and "scipy.linalg._flapack" not in sys.modules
lapack.dposv
import erfa
assert late_erfa.gd2gc is erfa.gd2gc and late_erfa.WGS84 == erfa.WGS84
assert not hasattr(lapack, "dgemm") and not hasattr(late_erfa, "nothing")
"""
    subprocess.run([sys.executable, "-c", check], cwd=tmp_path, check=True, timeout=60)
