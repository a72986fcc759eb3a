"""Writes docs/reference/licences.md: the licence of every wheel of the lock, as stated in the wheel.

With --check nothing is written. Exits with 1 if a licence is not known, or does not permit distribution with this
suite, which is under Apache-2.0.
"""

import argparse
import importlib.metadata
import os
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements.lock"
PAGE = ROOT / "docs" / "reference" / "licences.md"

STATED_ELSEWHERE = {
    "apsw": ("Zlib", "its LICENSE; or any that OSI approves"),
    "docutils": ("CC-PDDC AND BSD-2-Clause AND 0BSD", "its COPYING; GPL-3.0 is an Emacs file, not in the wheel"),
    "empy": ("LGPL-2.1-or-later", "`__license__` in its em.py"),
    "exceptiongroup": ("MIT", "its metadata on PyPI; Python 3.10 only"),
    "python-dateutil": ("Apache-2.0 OR BSD-3-Clause", "its LICENSE"),
    "ros-fastcdr": ("Apache-2.0", "its LICENSE"),
    "ros-fastrtps": ("Apache-2.0", "its LICENSE"),
    "setuptools": ("MIT", "its LICENSE"),
    "tomli": ("MIT", "its metadata on PyPI; Python 3.10 only"),
}
"""Distribution → licence and its source, if the installed metadata does not state it."""

_SPDX = {
    "0BSD": ("0BSD",),
    "Apache-2.0": ("Apache License, Version 2.0", "Apache 2.0", "Apache License 2.0", "Apache Software License"),
    "BSD-2-Clause": ("BSD 2-Clause License", "Simplified BSD license"),
    "BSD-3-Clause": ("BSD 3-Clause License",),
    "BSD": ("BSD License",),
    "CC-PDDC": (),
    "CC0-1.0": (),
    "MIT": ("MIT License",),
    "MIT-0": (),
    "MIT-CMU": (),
    "PSF-2.0": ("Python Software Foundation License",),
    "Zlib": ("zlib License",),
    "LGPL-2.1-or-later": (),
    "MPL-2.0": ("Mozilla Public License 2.0 (MPL 2.0)",),
}
"""Licences that permit distribution with Apache-2.0 → their other names."""
_NAMES = {name: spdx for spdx, others in _SPDX.items() for name in (spdx, *others)}
_COPYLEFT = ("LGPL-2.1-or-later", "MPL-2.0")

HEAD = """# Licences

The suite itself is under Apache-2.0. Each wheel that [`make setup`](../how-to/install.md) installs has its own licence,
also in the tar of `make bundle`, which has it unchanged. Wheels under MPL-2.0 or LGPL (marked *) require that their
source is distributed with them or named: they are that source, except hypothesis, whose source is on PyPI. Changes of
one of them must be distributed under the same licence.

Some wheels contain third-party libraries: numpy and scipy have OpenBLAS and runtime libraries of GCC (GPL-3.0 with the
exception for runtime libraries; libquadmath LGPL). Their licences are in the wheels, in `*.dist-info/`.

*From* is the source of the licence: the metadata of the wheel, its `package.xml`, or another file.

This page is written by `python tools/licences.py`; a test compares it with the wheels that are installed.

| wheel | licence | from |
|---|---|---|
"""


def distributions() -> list[str]:
    """Return the names of the wheels of the lock, each once."""
    names = re.findall(r"^([A-Za-z0-9][\w.-]*)==", LOCK.read_text(encoding="utf-8"), re.MULTILINE)
    return sorted(set(names), key=str.lower)


def licence(name: str) -> tuple[str, str]:
    """Return the SPDX licence of a wheel, empty if not known, and the place where the licence is stated."""
    if name in STATED_ELSEWHERE:
        return STATED_ELSEWHERE[name]
    try:
        metadata = importlib.metadata.metadata(name)
    except importlib.metadata.PackageNotFoundError:
        return "", "not installed"
    if expression := metadata.get("License-Expression"):
        return expression, "metadata"
    classifiers = metadata.get_all("Classifier", [])
    classified = [line.rpartition(" :: ")[2] for line in classifiers if line.startswith("License")]
    for stated in ([metadata.get("License", "")], classified, _in_package_xml(name)):
        if any(stated):
            found = sorted({_NAMES[text] for text in stated if text in _NAMES})
            if len(found) == len(set(stated)):
                return " AND ".join(found), "package.xml" if stated == _in_package_xml(name) else "metadata"
    return "", f"unreadable: {(classified or [metadata.get('License', 'nothing')])[0][:40]}"


def _in_package_xml(name: str) -> list[str]:
    """Return the licences in the package.xml of a ROS wheel."""
    package = re.sub("^ros-(jazzy-)?", "", name).replace("-", "_")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if name.startswith("ros-") else []:
        path = Path(prefix) / "share" / package / "package.xml"
        if path.exists():
            return [(element.text or "").strip() for element in ET.parse(path).iter("license")]
    return []


def is_compatible(expression: str) -> bool:
    """True if one of the alternative licences permits distribution with Apache-2.0."""
    choices = [re.split(r" AND ", choice.strip("() ")) for choice in expression.split(" OR ")]
    return any(all(part.strip("() ") in _SPDX for part in parts) for parts in choices)


def page() -> str:
    """Return the text of docs/reference/licences.md."""
    text = HEAD
    for name in distributions():
        stated, place = licence(name)
        mark = " *" if any(word in stated for word in _COPYLEFT) else ""
        text += f"| `{name}` | {stated or 'not known'}{mark} | {place} |\n"
    return text


def incompatible_licences() -> list[str]:
    """Return one line for each wheel that must not be distributed, or whose licence is not known."""
    lines = []
    for name in distributions():
        stated, place = licence(name)
        if not is_compatible(stated):
            lines.append(f"{name}: {stated or 'licence not known'} ({place})")
    return lines


def main() -> int:
    """Write the page, or check the licences."""
    parser = argparse.ArgumentParser(description="The licences of all wheels of the lock.", allow_abbrev=False)
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a licence does not fit")
    options = parser.parse_args()
    if not options.check:
        PAGE.write_text(page(), encoding="utf-8")
        print(PAGE.relative_to(ROOT))
    lines = incompatible_licences()
    for line in lines:
        print(f"licences: {line}", file=sys.stderr)
    print(f"licences: {len(distributions())} wheels, {len(lines)} that do not fit Apache-2.0")
    return 1 if lines else 0


if __name__ == "__main__":
    raise SystemExit(main())
