"""The examples in the docstrings of geometry and estimation run as printed, and every public function has one."""

import doctest
import importlib
import inspect
import pkgutil

import pytest

import ship_estimation
import ship_geometry

MODULES = [
    module.name
    for package in (ship_geometry, ship_estimation)
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + ".")
    if not module.name.rpartition(".")[2].startswith("compiled_")
]
"""Modules with examples; the examples of compiled modules are in the modules that call the compiled modules."""


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name: str) -> None:
    outcome = doctest.testmod(importlib.import_module(name), optionflags=doctest.FAIL_FAST)
    assert outcome.failed == 0, f"{name}: its output is above"


@pytest.mark.parametrize("name", MODULES)
def test_every_public_function_has_an_example(name: str) -> None:
    module = importlib.import_module(name)
    functions = [
        value
        for value in vars(module).values()
        if inspect.isroutine(inspect.unwrap(value)) and value.__module__ == name and not value.__name__.startswith("_")
    ]
    assert [f.__name__ for f in functions if ">>>" not in (f.__doc__ or "")] == []
