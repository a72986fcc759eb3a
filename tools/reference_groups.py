"""The pages into which tools/reference_pages.py splits the long references, and the function that splits them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatch

WRITTEN = "This page is written by `python tools/reference_pages.py`; a test compares it with the code.\n"


@dataclass(frozen=True)
class Group:
    """A page: title, one line about its content, and its sections.

    ``sections`` contains patterns separated by spaces. A section is on the first page with a pattern that fits it.
    """

    title: str
    about: str
    sections: str

    def has(self, section: str) -> bool:
        """True if a pattern fits the section."""
        return any(fnmatch(section, pattern) for pattern in self.sections.split())


MESSAGES = {
    "attitude": Group("Attitude", "the ship's attitude, its error, the vertical", "ShipAttitude Attitude* Deflection"),
    "pointing": Group("Pointing", "encoders, optical axis, calibration", "OpticalAxis* Pointing* Theodolite*"),
    "stars": Group("Stars", "stars on a detector, and attitudes from stars", "Star*"),
    "beacons": Group("Beacons", "lights, their positions, courses for drones", "Beacon* RtkBaseline EscortAdvice"),
    "targets": Group("Targets", "images of targets, and directions to them", "Target*"),
    "health": Group(
        "Health and integrity",
        "innovations, rejections, protection levels, error budget, states of the filter",
        "Innovation InputHealth Integrity ErrorBudget AlignmentState",
    ),
    "alerts": Group("Suite state and alerts", "states of angles and sources, alerts", "Suite* Alert*"),
}  # fmt: skip

PARAMETERS = {
    "ship_attitude_inputs": Group(
        "ship_attitude: inputs",
        "INS, star sensors, references and baseline of `ship_attitude`",
        " ".join(f"ship_attitude/{name}" for name in ("ins", "star_sensors", "references", "ship_baseline")),
    ),
    "ship_attitude": Group("ship_attitude", "vertical, sky, filter and outputs of `ship_attitude`", "ship_attitude/*"),
    "star_attitude": Group("star_attitude", "all of `star_attitude`", "star_attitude/*"),
    "optical_axis_inputs": Group(
        "optical_axis: inputs",
        "attitude, encoders, telescopes and beacons of `optical_axis`",
        " ".join(f"optical_axis/{name}" for name in ("ship*", "ins", "encoder", "telescope*", "main*", "beacons")),
    ),
    "optical_axis": Group("optical_axis", "axes, air, sky, filter and outputs of `optical_axis`", "optical_axis/*"),
    "triangulation": Group("triangulation", "all of `triangulation`", "triangulation/*"),
    "nmea_in": Group("nmea_in", "all of `nmea_in`", "nmea_in/*"),
    "nmea_out": Group("nmea_out", "all of `nmea_out`", "nmea_out/*"),
}  # fmt: skip

SCENARIO = {
    "voyage": Group("Voyage", "time, place, motion, vertical and weather", "scenario carrier position gravity weather"),
    "ship_sensors": Group("Ship sensors", "INS, star sensors and others", "ins star_sensors references ship_baseline"),
    "theodolite": Group("Theodolite", "the theodolite and its input `ship/attitude`", "theodolite fused_attitude"),
    "telescopes": Group("Telescopes", "what they observe: beacons, targets, stars", "beacons targets telescopes"),
    "faults": Group("Faults", "faults that are injected", "faults"),
}  # fmt: skip

EXECUTABLES = {
    "ship_attitude_star": Group("ship_attitude_star", "attitude from INS and star sensors", "ship_attitude_star/*"),
    "ship_bags": Group("ship_bags", "bags: record, play, import, export", "ship_bags/*"),
    "ship_bringup": Group("ship_bringup", "a suite checked and started", "ship_bringup/*"),
    "ship_monitor": Group("ship_monitor", "live page, terminal, alerts", "ship_monitor/*"),
    "ship_nmea": Group("ship_nmea", "NMEA 0183, in and out", "ship_nmea/*"),
    "ship_replay": Group(
        "ship_replay: replay",
        "recordings replayed, evaluated and compared",
        " ".join(f"ship_replay/{name}" for name in ("replay", "evaluate", "report", "compare", "stanford")),
    ),
    "ship_replay_files": Group("ship_replay: smooth and check_config", "smoothing, check of files", "ship_replay/*"),
    "ship_simulation": Group("ship_simulation", "simulated voyages and faults", "ship_simulation/*"),
    "ship_studies": Group("ship_studies", "layout, design, axes, installation, noise, campaigns", "ship_studies/*"),
    "theodolite_calib": Group("theodolite_calib", "pointing of the theodolite", "theodolite_calib/*"),
}  # fmt: skip


def page_of(section: str, groups: Mapping[str, Group]) -> str:
    """Return the page of a section; raise LookupError if no page fits."""
    for page, group in groups.items():
        if group.has(section):
            return page
    raise LookupError(f"no page in tools/reference_groups.py for {section}")


def split(kind: str, head: str, sections: Mapping[str, str], groups: Mapping[str, Group]) -> dict[str, str]:
    """Return the texts of the index ``kind.md`` and of its pages in the folder ``kind``, by their paths.

    The key of a section is its heading, after "node/" or "package/" if headings repeat.
    """
    title = re.findall("^# (.*)", head)[0]
    pages = {
        page: f"# {title}: {group.title}\n\n{group.about[0].upper()}{group.about[1:]}. "
        f"Index, and notes for all pages: [{title}](../{kind}.md).\n\n{WRITTEN}"
        for page, group in groups.items()
    }
    contents: dict[str, list[str]] = {page: [] for page in groups}
    for section, text in sections.items():
        page, heading = page_of(section, groups), section.rpartition("/")[2]
        pages[page] += f"\n## `{heading}`\n\n{text}"
        contents[page].append(f"[`{heading}`]({kind}/{page}.md#{heading.lower()})")
    index = f"{head}\n| page | about | contents |\n|---|---|---|\n"
    for page, group in groups.items():
        index += f"| [{group.title}]({kind}/{page}.md) | {group.about} | {', '.join(contents[page])} |\n"
    return {f"{kind}.md": index} | {f"{kind}/{page}.md": text for page, text in pages.items()}
