"""Prebuilt wheels of our own packages: built by ``make wheels``, and used by setup instead of compiling.

The wheels are in prebuilt/, in a folder for each Python and machine. The version of a wheel ends in the digest of the
package's sources, by which setup checks that the wheel fits the sources of the checkout. Setup uses only the compiled
modules and the messages of a wheel; Python sources are always taken from the checkout.

Only Python's standard library is imported: setup starts before other packages are installed.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

PREBUILT = "prebuilt"
COMPILED_SUFFIX = ".so"
_DIGEST_LENGTH = 16
_GENERATED = {"__pycache__", "test", ".pytest_cache", ".mypy_cache", ".ruff_cache"}
_READ = ("package.xml", "setup.py", "setup.cfg", "CMakeLists.txt")
_NAME = re.compile(rf"(\w+)-[\d.]+\+([0-9a-f]{{{_DIGEST_LENGTH}}})-[\w.]+-[\w.]+-[\w.]+\.whl")


def digest(*parts: str | bytes) -> str:
    """Return one hexadecimal digest of all parts."""
    total = hashlib.sha256()
    for part in parts:
        total.update(part.encode() if isinstance(part, str) else part)
        total.update(b"\0")
    return total.hexdigest()


def package_digests(folders: list[Path], tools: str) -> dict[Path, str]:
    """Return for each package the digest of the files that require a new build when they change.

    Due to symlinks an edited Python file requires no build, unless the file is a compiled module or setup.py. An edited
    package.xml or message, and a new launch, parameter or resource file, require a build.

    Args:
        folders: folders of the packages.
        tools: versions of the build tools, Python, machine.
    """
    return {folder: digest(tools, *_content(folder)) for folder in folders}


def _content(folder: Path) -> list[str | bytes]:
    parts: list[str | bytes] = []
    for path in sorted(folder.rglob("*")):
        inner = path.relative_to(folder).parts
        if _GENERATED.intersection(inner) or any(part.endswith(".egg-info") for part in inner) or not path.is_file():
            continue
        if path.name in _READ or path.suffix in (".msg", ".srv", ".action"):
            parts += ["/".join(inner), path.read_bytes()]
        elif path.name.startswith("compiled_"):
            # Generated C files and compiled modules are next to their source; only the source is part of the digest.
            parts += ["/".join(inner), path.read_bytes()] if path.suffix in (".py", ".pxd") else []
        elif path.suffix not in (".py", ".pyc", ".pyi"):
            parts.append("/".join(inner))  # launch, parameter and resource files
    return parts


def local_version(content: str) -> str:
    """Return the end of a wheel's version, which contains a digest of :func:`package_digests`."""
    return f"+{content[:_DIGEST_LENGTH]}"


@dataclass(frozen=True)
class Prebuilt:
    """A prebuilt wheel that fits the sources.

    Attributes:
        folder: folder of the package.
        wheel: path of the wheel.
    """

    folder: Path
    wheel: Path

    def unpack(self, install: Path) -> None:
        """Unpack compiled modules next to their sources, and messages into install/, in colcon's layout.

        Args:
            install: colcon's folder of installed packages.

        Raises:
            OSError: the wheel is damaged, or a file cannot be written.
        """
        is_of_messages = (self.folder / "CMakeLists.txt").exists()
        try:
            with zipfile.ZipFile(self.wheel) as archive:
                for name in archive.namelist():
                    _, _, inner = name.partition(".data/data/")
                    if is_of_messages and inner:
                        _unpack(archive, name, install / self.folder.name / inner)
                    elif not is_of_messages and name.endswith(COMPILED_SUFFIX):
                        _unpack(archive, name, self.folder / name)
        except (zipfile.BadZipFile, zlib.error, EOFError) as error:
            raise OSError(f"{self.wheel} is damaged ({error}): copy or build it again") from error


def _unpack(archive: zipfile.ZipFile, name: str, path: Path) -> None:
    if ".." in Path(name).parts:
        raise OSError(f"{archive.filename}: {name} is a path outside the folder")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    with archive.open(name) as source, path.open("wb") as target:
        shutil.copyfileobj(source, target)


def find_prebuilt(place: Path, wanted: dict[Path, str]) -> tuple[list[Prebuilt], list[str]]:
    """Return the wheels that fit, and a line for each package whose wheel was built from other sources or tools.

    Args:
        place: the folder of wheels for this Python and machine; the folder may be missing.
        wanted: folder of each package → its digest.
    """
    wheels: dict[str, dict[str, Path]] = {}
    for path in sorted(place.glob("*.whl")):
        if match := _NAME.fullmatch(path.name):
            wheels.setdefault(match[1], {})[match[2]] = path
    found, unfit = [], []
    for folder, content in wanted.items():
        named = wheels.get(folder.name, {})
        if wheel := named.get(content[:_DIGEST_LENGTH]):
            found.append(Prebuilt(folder, wheel))
        elif named:
            wheel = next(iter(named.values()))
            unfit.append(f"{wheel.name} was built from other sources or tools: {folder.name} is built here")
    return found, unfit
