"""``make wheels``: builds wheels of our own packages for this Python and machine into prebuilt/, for later setups.

A checkout of the same sources with this folder is set up without a compiler. Exit code 0 done; 2 a package could not
be built.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from prebuilt import PREBUILT, local_version
from setup_build import is_of_messages, stamp_of
from setup_common import CORES, INSTALL, ROOT, last_line, read_stamp
from setup_environment import make_plan

from wheelhouse import own_target

_FIXED_TIME = (2000, 1, 1, 0, 0, 0)


def main() -> int:
    """Build the wheels."""
    own = Path(PREBUILT) / own_target()
    parser = argparse.ArgumentParser(prog="wheels", description=__doc__, allow_abbrev=False)
    parser.add_argument("--out", type=Path, default=ROOT / own, metavar="DIR", help=f"folder for the wheels ({own})")
    folder = parser.parse_args().out.resolve()
    workspace = make_plan().workspace
    with tempfile.TemporaryDirectory() as work, ThreadPoolExecutor(CORES) as pool:
        out = Path(work) / "wheels"
        out.mkdir()
        jobs = {
            package: pool.submit(_pack_messages if is_of_messages(package) else _build, package, content, out)
            for package, content in workspace.digests.items()
        }
        for package, job in jobs.items():
            if error := job.exception():
                detail = last_line(error.output) if isinstance(error, subprocess.CalledProcessError) else error
                print(f"wheels: {package.relative_to(ROOT)}: {detail}", file=sys.stderr)
                return 2
        folder.mkdir(parents=True, exist_ok=True)
        for package in workspace.digests:
            for path in folder.glob(f"{package.name}-*+*.whl"):
                path.unlink()
        made = [Path(shutil.copy(path, folder)) for path in sorted(out.iterdir())]
    for path in made:
        print(f"wheels: {path.relative_to(ROOT) if path.is_relative_to(ROOT) else path}")
    print(f"wheels: {len(made)} wheels, {sum(path.stat().st_size for path in made) / 1e6:.1f} MB")
    return 0


def _build(package: Path, content: str, out: Path) -> None:
    """Build a wheel of a Python package from a copy, so that no files are left in the sources."""
    with tempfile.TemporaryDirectory() as work:
        copy = Path(work) / package.name
        made = shutil.ignore_patterns("test", "__pycache__", "*.egg-info", "*.so", "compiled_*.c", "compiled_*.sha256")
        shutil.copytree(package, copy, ignore=made)
        tag = f"--tag-build={local_version(content)}"
        command = [sys.executable, "setup.py", "-q", "egg_info", tag, "bdist_wheel", "--dist-dir"]
        environment = {name: value for name, value in os.environ.items() if name != "SHIP_SUITE_IS_COMPILED"}
        subprocess.run(
            [*command, str(out)], cwd=copy, env=environment, check=True, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip


def _pack_messages(package: Path, content: str, out: Path) -> None:
    """Pack the installed files of a message package with their paths below the prefix, as the wheels of ROS do."""
    if read_stamp(stamp_of(package)) != content:
        raise OSError("the installed files were built from other sources: run make setup")
    root = ET.parse(package / "package.xml").getroot()
    version = f"{root.findtext('version')}{local_version(content)}"
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}"
    platform_tag = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    stem = f"{package.name}-{version}"
    info = f"{stem}.dist-info"
    files = {
        f"{stem}.data/data/{path.relative_to(INSTALL / package.name)}": path.read_bytes()
        for path in sorted((INSTALL / package.name).rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    }
    summary = " ".join((root.findtext("description") or "").split())
    files[f"{info}/METADATA"] = (
        f"Metadata-Version: 2.1\nName: {package.name}\nVersion: {version}\nSummary: {summary}\n"
        f"License: {root.findtext('license')}\n"
    ).encode()
    files[f"{info}/WHEEL"] = (
        f"Wheel-Version: 1.0\nGenerator: make_wheels\nRoot-Is-Purelib: false\nTag: {tag}-{tag}-{platform_tag}\n"
    ).encode()
    record = "".join(f"{name},sha256={_record_hash(content)},{len(content)}\n" for name, content in files.items())
    files[f"{info}/RECORD"] = f"{record}{info}/RECORD,,\n".encode()
    with zipfile.ZipFile(out / f"{stem}-{tag}-{tag}-{platform_tag}.whl", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, _FIXED_TIME), content, zipfile.ZIP_DEFLATED)


def _record_hash(content: bytes) -> str:
    """Return the hash of a file in the format of RECORD."""
    return base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")


if __name__ == "__main__":
    raise SystemExit(main())
