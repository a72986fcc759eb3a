"""Fixtures of the tests of this package."""

from ship_testing.own_domain import own_domain, until  # noqa: F401 - fixtures
