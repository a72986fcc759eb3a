"""Wheels of a bundle, for a setup without a network, in wheels/ with a folder for each Python and machine.

``SHA256SUMS`` in each folder lists requirements.lock and every wheel, in the format of ``sha256sum -c SHA256SUMS``.
Only Python's standard library is imported: setup starts before other packages are installed.
"""

from __future__ import annotations

import functools
import hashlib
import platform
import re
import sys
from pathlib import Path

WHEELS = "wheels"
SUMS = "SHA256SUMS"
LOCK = "requirements.lock"
_LOCK_FROM_WHEELS = f"../../{LOCK}"
_LINE = re.compile(rf"([0-9a-f]{{64}})  ({re.escape(_LOCK_FROM_WHEELS)}|[\w.+-]+\.whl)")

NETWORK_SIGNS = (
    "NewConnectionError",
    "name resolution",
    "ConnectTimeout",
    "ReadTimeout",
    "Connection refused",
    "ProxyError",
    "Network is unreachable",
)


SECTIONS = ("ros", "build", "python", "all")
"""Sections of requirements.lock, in the order of the file; ``all`` is installed only by ``make setup-all``."""


class WheelsRefused(Exception):
    """Fault of requirements.lock or of the wheels of a bundle; the text is one line."""


def target(python: str, machine: str) -> str:
    """Return the name of the folder for a Python, for example 3.11, and a machine, for example x86_64."""
    return f"python{python}-{machine}"


def own_target() -> str:
    """Return the name of the folder for this Python and machine."""
    return target(f"{sys.version_info.major}.{sys.version_info.minor}", platform.machine())


def locked_requirements(lock: str) -> dict[str, list[str]]:
    """Return the requirements of each section of requirements.lock; a section begins with ``# [name]``.

    Raises:
        WheelsRefused: a requirement is before the first section, or a section is not in :data:`SECTIONS`.
    """
    sections: dict[str, list[str]] = {name: [] for name in SECTIONS}
    current: list[str] | None = None
    for number, line in enumerate(lock.splitlines(), 1):
        if heading := re.match(r"# \[(\w+)\]", line):
            current = sections.get(heading[1])
            if current is None:
                raise WheelsRefused(f"{LOCK} line {number}: section [{heading[1]}] is not one of {', '.join(SECTIONS)}")
        elif re.match(r"[A-Za-z0-9]", line):
            if current is None:
                raise WheelsRefused(f"{LOCK} line {number}: '{line}' is before the first section")
            current.append(line.strip())
    return sections


def pin_of_requirement(requirement: str) -> str:
    """Return a line of the lock as name==version, with the normalised name and without its condition."""
    name, _, version = requirement.partition(";")[0].strip().partition("==")
    return f"{re.sub(r'[-_.]+', '-', name).lower()}=={version}"


def pin_of_wheel(wheel: str) -> str:
    """Return the pin of a wheel with this file name."""
    name, version, *_ = wheel.split("-")
    return pin_of_requirement(f"{name}=={version}")


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    total = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            total.update(block)
    return total.hexdigest()


def checksum_text(lock: bytes, wheels: list[Path]) -> str:
    """Return the text of ``SHA256SUMS``."""
    named = [(hashlib.sha256(lock).hexdigest(), _LOCK_FROM_WHEELS), *((sha256(path), path.name) for path in wheels)]
    return "".join(f"{digest}  {name}\n" for digest, name in named)


def own_wheels(root: Path) -> Path | None:
    """Return the folder of wheels for this Python and machine; None if the checkout has no wheels.

    Raises:
        WheelsRefused: there are wheels only for other Pythons or machines.
    """
    folder = root / WHEELS
    if not folder.is_dir():
        return None
    own = own_target()
    if (folder / own).is_dir():
        return folder / own
    there = sorted(path.name for path in folder.iterdir() if path.is_dir())
    raise WheelsRefused(
        f"the wheels in {WHEELS}/ are for {', '.join(there) or 'nothing'}, this is {own} ({sys.executable}): set"
        " PYTHON=/path/to/python3 to one that fits, make a bundle for this one with a network (make bundle"
        f" FOR={own.removeprefix('python').partition('-')[0]}), or remove {WHEELS}/ to install from the network"
    )


@functools.cache
def hashed_requirements(folder: Path) -> dict[str, str]:
    """Return the requirement with its hash for each pin of a folder of wheels, after checking all hashes.

    Raises:
        WheelsRefused: a wheel or ``SHA256SUMS`` is missing or damaged, or the wheels belong to another lock.
    """
    place = f"{WHEELS}/{folder.name}"
    requirements = {}
    for digest, name in _read_sums(folder / SUMS, place):
        path = folder / name
        if not path.is_file():
            raise WheelsRefused(f"{place}/{name} is missing: unpack the bundle again")
        if sha256(path) == digest:
            if name != _LOCK_FROM_WHEELS:
                requirements[pin_of_wheel(name)] = f"{pin_of_wheel(name)} --hash=sha256:{digest}"
        elif name == _LOCK_FROM_WHEELS:
            raise WheelsRefused(
                f"{place} was made for another {LOCK}: make a new bundle, or remove {WHEELS}/ to use the network"
            )
        else:
            raise WheelsRefused(
                f"{place}/{name} is damaged, its SHA-256 differs from {SUMS}: unpack the bundle again"
            )
    for line in (folder / _LOCK_FROM_WHEELS).read_text().splitlines():
        if re.match(r"[A-Za-z0-9]", line) and ";" not in line and pin_of_requirement(line) not in requirements:
            raise WheelsRefused(f"{place}/{SUMS} has no wheel of {line.strip()}: unpack the bundle again")
    return requirements


def _read_sums(path: Path, place: str) -> list[tuple[str, str]]:
    """Return SHA-256 and name of each file, beginning with the lock."""
    lines = path.read_text(errors="replace").splitlines() if path.is_file() else []
    found = [_LINE.fullmatch(line) for line in lines]
    for number, match in enumerate(found, 1):
        if match is None:
            raise WheelsRefused(f"{place}/{SUMS} line {number}: SHA-256 and name expected: unpack the bundle again")
    pairs = [(match[1], match[2]) for match in found if match is not None]
    if not pairs or pairs[0][1] != _LOCK_FROM_WHEELS:
        raise WheelsRefused(f"{place}/{SUMS} is missing or does not begin with {LOCK}: unpack the bundle again")
    return pairs
