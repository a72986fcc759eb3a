"""LAPACK and ERFA are imported on first use; the functions are scipy's and ERFA's own, for either order of import."""

import subprocess
import sys
from pathlib import Path

import pytest

SAME = "assert all(getattr(lapack, n) is getattr(scipy.linalg.lapack, n) for n in ('dgesdd', 'dposv', 'dpotrf'))"


def run(code: str, folder: Path) -> None:
    subprocess.run([sys.executable, "-c", code], cwd=folder, check=True, timeout=60)


@pytest.mark.parametrize(
    "imports",
    [
        "from ship_geometry.late_libraries import lapack; lapack.dposv; import scipy.linalg.lapack",
        "import scipy.linalg.lapack; from ship_geometry.late_libraries import lapack",
    ],
)
def test_functions_are_those_of_scipy(imports: str, tmp_path: Path) -> None:
    run(f"{imports}; {SAME}", tmp_path)


def test_no_other_module_of_scipy_is_imported(tmp_path: Path) -> None:
    code = """
import sys
from ship_geometry.late_libraries import lapack
lapack.dposv
assert 'scipy' not in sys.modules and 'scipy.linalg' not in sys.modules
"""
    run(code, tmp_path)


def test_lapack_and_erfa_are_imported_on_first_use(tmp_path: Path) -> None:
    code = """
import sys
from ship_geometry import wahba
from ship_geometry.earth import geodetic, star_directions
from ship_geometry.late_libraries import erfa, lapack
assert "erfa" not in sys.modules and "scipy.linalg._flapack" not in sys.modules
lapack.dposv
late_gd2gc = erfa.gd2gc
import erfa as own
assert late_gd2gc is own.gd2gc and erfa.WGS84 == own.WGS84
assert not hasattr(lapack, "nothing") and not hasattr(erfa, "nothing")
"""
    run(code, tmp_path)
