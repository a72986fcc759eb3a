"""Imports of a package are declared in its package.xml and setup.py; libraries only on PyPI have a reason."""

import pytest

from tools.dependencies import (
    LIBRARIES,
    PAGE,
    SRC,
    declared_keys,
    imported_names,
    libraries,
    packages,
    page,
    required_distributions,
)

PYTHON_PACKAGES = [package for package in packages() if imported_names(SRC / package / package)]


def test_the_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run tools/dependencies.py"


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_every_import_of_a_package_is_declared(package: str) -> None:
    """Libraries are declared by their rosdep key, if any, and in setup.py; packages of ROS and of the suite by name."""
    keys, distributions = declared_keys(package, "depend", "exec_depend"), required_distributions(package)
    wanted = imported_names(SRC / package / package) - {package}
    assert {LIBRARIES[name].key for name in wanted if name in LIBRARIES} - {""} - keys == set(), "package.xml"
    assert {LIBRARIES[name].distribution for name in wanted if name in LIBRARIES} - distributions == set(), "setup.py"
    assert {name for name in wanted if name not in LIBRARIES} - keys == set(), "package.xml, or LIBRARIES"


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_no_library_is_declared_that_is_not_imported(package: str) -> None:
    used = {library.key for library in libraries(package)}
    assert {
        key for key in declared_keys(package, "depend", "exec_depend") if key.startswith("python3-")
    } - used == set()
    tested = {LIBRARIES[name].distribution for name in imported_names(SRC / package) & LIBRARIES.keys()}
    assert required_distributions(package) - tested - set(packages()) - {"setuptools"} == set()


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_every_library_that_tests_import_is_listed_and_declared(package: str) -> None:
    """Packages of ROS and of the suite are exempt: tests use all of them, and all are built."""
    keys = declared_keys(package, "depend", "exec_depend", "test_depend")
    wanted = imported_names(SRC / package / "test") & LIBRARIES.keys()
    assert {LIBRARIES[name].key for name in wanted} - {""} - keys == set()


def test_a_library_has_a_key_or_a_reason() -> None:
    for library in LIBRARIES.values():
        assert bool(library.key) != bool(library.use), library
        assert not library.key.endswith("-pip"), library
    used = set().union(*(imported_names(SRC / package) for package in packages()))
    by_name_alone = {"serial", "cryptography", "pyarrow", "gtsam"}
    assert LIBRARIES.keys() - used - by_name_alone == set(), "no package imports it"
