"""The wrapped functions are scipy's own, whichever of the two is read first."""

import subprocess
import sys

import pytest

SAME = "assert all(getattr(lapack, n) is getattr(scipy.linalg.lapack, n) for n in ('dgesdd', 'dposv', 'dpotrf'))"


@pytest.mark.parametrize(
    "imports",
    [
        "from ship_geometry import lapack; import scipy.linalg.lapack",
        "import scipy.linalg.lapack; from ship_geometry import lapack",
    ],
)
def test_functions_are_those_of_scipy(imports: str) -> None:
    subprocess.run([sys.executable, "-c", f"{imports}; {SAME}"], check=True, timeout=60)


def test_nothing_else_of_scipy_is_read() -> None:
    check = "import sys; from ship_geometry import lapack; assert 'scipy' not in sys.modules"
    subprocess.run([sys.executable, "-c", check], check=True, timeout=60)
