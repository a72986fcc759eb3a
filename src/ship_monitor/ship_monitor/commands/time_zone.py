"""Option ``--time-zone``: local time in addition to UTC."""

import argparse
from zoneinfo import ZoneInfo


def add_time_zone(parser: argparse.ArgumentParser) -> None:
    """Add the option; its value is a ZoneInfo, or None for UTC alone."""
    parser.add_argument(
        "--time-zone",
        type=_zone,
        metavar="ZONE",
        help="also show local time of this IANA zone, for example Europe/Oslo (UTC only)",
    )


def _zone(name: str) -> ZoneInfo:
    try:
        return ZoneInfo(name)
    # KeyError: unknown zone. ValueError: a path or an empty name. OSError: the name of a folder of zones.
    except (KeyError, ValueError, OSError) as problem:
        text = f"{name!r} is not a time zone: use an IANA name like Europe/Oslo; timedatectl list-timezones lists them"
        raise argparse.ArgumentTypeError(text) from problem
