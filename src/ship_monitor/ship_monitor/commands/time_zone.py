"""Option ``--time-zone``: local time, shown beside UTC."""

import argparse
from zoneinfo import ZoneInfo


def add_time_zone(parser: argparse.ArgumentParser) -> None:
    """Add the option; its value is a ZoneInfo, or None for UTC alone."""
    parser.add_argument(
        "--time-zone",
        type=_zone,
        metavar="ZONE",
        help="show local time of this IANA zone beside UTC, for example Europe/Oslo (UTC alone)",
    )


def _zone(name: str) -> ZoneInfo:
    try:
        return ZoneInfo(name)
    # No such zone; a path or an empty name; the name of a folder of zones.
    except (KeyError, ValueError, OSError) as problem:
        text = f"{name!r} is no time zone: give an IANA name such as Europe/Oslo; timedatectl list-timezones lists them"
        raise argparse.ArgumentTypeError(text) from problem
