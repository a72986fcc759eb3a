"""Options of page and terminal: limits of the ship, theme, and local time in addition to UTC."""

import argparse
from pathlib import Path
from zoneinfo import ZoneInfo

from ship_monitor.themes import THEMES


def add_display_options(parser: argparse.ArgumentParser, theme_help: str) -> None:
    """Add ``--limits``, ``--theme`` and ``--time-zone``, whose value is a ZoneInfo, or None for UTC alone."""
    parser.add_argument("--limits", type=Path, metavar="FILE", help="YAML file with the limits of the ship (defaults)")
    parser.add_argument("--theme", choices=tuple(THEMES), default="day", help=theme_help)
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
