"""``nmea_out``: the ship's attitude and alerts as NMEA sentences over UDP, TCP, serial lines and to files."""

from collections.abc import Sequence

from ship_nmea.nmea_node import run_nmea_node
from ship_nmea.out.config import NmeaOutConfig
from ship_nmea.out.nmea_out import NmeaOut

NAME = "nmea_out"

_DESCRIPTION = """\
Sends ship/attitude as HDT, THS, ROT, PASHR and PSXN, and ship/alerts as ALF, ALC and HBT, to any number of sinks: UDP
(one host, broadcast, a group), TCP server, serial line, file. An attitude that is INVALID, missing or older than
longest_age_s is sent void, with status V, never as an old value. The bridge's alert management acknowledges with ACN
over the same sink (udp: listen_port); a refused command is answered with ARC.

A receiver that does not read, a lost line or a full disk delays nothing: dropped sentences are counted in /diagnostics,
and the sink is opened again every 2 s.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``nmea_out``; return the exit code."""
    return run_nmea_node(NAME, _DESCRIPTION, NmeaOutConfig, NmeaOut, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
