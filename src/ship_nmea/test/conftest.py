"""Fixtures of the tests of this package."""

import pytest

from ship_testing.own_domain import own_domain, until  # noqa: F401 - fixtures


@pytest.fixture
def listening(tmp_path):
    """Start nmea_in with some sources; see :class:`ship_testing.nmea_in_peer.NmeaInPeer`."""
    from ship_testing.nmea_in_peer import NmeaInPeer

    started = []

    def start(sources, **options):
        started.append(NmeaInPeer(tmp_path / "nmea_in.yaml", sources, **options))
        return started[-1]

    yield start
    for node in started:
        node.close()
