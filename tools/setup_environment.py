"""Set up this checkout: virtual environment, pinned wheels, compiled modules, messages, packages.

Each step leaves a stamp when it is done. So a second run takes a moment, a change redoes only the steps that depend on
it, and an interrupted run is completed by running it again. Where the user has to do something, one line says what,
with exit code 2. ``--all`` also installs the wheels that few people use (section ``[all]`` of requirements.lock).

ROS 2 Jazzy comes as wheels into the virtual environment. Where a Jazzy installation is sourced, it is used instead, and
the virtual environment on top of it holds the other wheels only.

Steps that do not depend on each other run at the same time. The wheels of ROS and of the build tools come first;
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

from prebuilt import digest
from setup_build import Workspace, build_packages, compile_packages, compiled_parts, prepare_build, read_workspace
from setup_common import BUILD, ROOT, VENV, SetupError, read_stamp, say
from setup_wheels import (
    ALL_OTHER,
    BUILD_TOOLS,
    ROS_PREFIX_FILE,
    SECTIONS_OF_GROUPS,
    Group,
    byte_compile,
    check_machine,
    install_wheels,
    lines_to_install,
    make_venv,
    requirements,
    ros_prefix,
)

from wheelhouse import LOCK, WheelsRefused, locked, own_target, own_wheels

STAMP_VENV = VENV / ".stamp_venv"
STAMP_BUILD = BUILD / ".stamp_build"
COLCON_META = ROOT / "colcon.meta"


@dataclass(frozen=True)
class Plan:
    """The parts to set up, with the digests by which one that is there is recognised.

    Attributes:
        workspace: the packages to build.
        groups: the groups of wheels.
        venv: digest of what the virtual environment depends on.
        build: digest of all that is built.
    """

    workspace: Workspace
    groups: list[Group]
    venv: str
    build: str

    @property
    def fresh(self) -> bool:
        """True if set-up starts from nothing.

        Wheels half installed look like whole ones: a group has no stamp while it is installed. Over a Jazzy
        installation wheels of an older lock may hide its packages, and are removed too.
        """
        done = [group.is_installed if self.workspace.prefix else bool(read_stamp(group.stamp)) for group in self.basic]
        return read_stamp(STAMP_VENV) != self.venv or not all(done)

    @property
    def basic(self) -> list[Group]:
        """The groups of wheels that everybody needs."""
        return [group for group in self.groups if group.name != ALL_OTHER]


def make_plan(everything: bool = False) -> Plan:
    """Return the plan for this checkout and machine.

    Args:
        everything: also the wheels that few people use.
    """
    lock = locked((ROOT / LOCK).read_text(encoding="utf-8"))
    prefix = ros_prefix() or (read_stamp(ROS_PREFIX_FILE) if os.environ.get("ROS_DISTRO") is None else "")
    venv = digest(str(ROOT), f"{sys.version_info[:2]}", prefix)
    groups = [
        Group(name, lines_to_install(lock, sections, prefix), venv)
        for name, sections in SECTIONS_OF_GROUPS.items()
        if everything or name != ALL_OTHER
    ]
    meta = COLCON_META.read_text(encoding="utf-8") if COLCON_META.exists() else ""
    workspace = read_workspace(prefix, "\n".join([own_target(), *lock["ros"], *lock["build"], meta]))
    wheels = [group.digest for group in groups if group.name != ALL_OTHER]
    packages = [f"{folder.name} {content}" for folder, content in workspace.digests.items()]
    return Plan(workspace, groups, venv, digest(*wheels, *packages))


def set_up(everything: bool) -> None:
    """Do all steps, each only if needed."""
    begin_s = time.monotonic()
    plan = make_plan(everything)
    fresh, prefix = plan.fresh, plan.workspace.prefix
    groups = [group for group in plan.groups if fresh or not group.is_installed]
    needs_build = fresh or read_stamp(STAMP_BUILD) != plan.build
    if not groups and not needs_build:
        return
    check_machine(fresh)
    parts = compiled_parts(plan.workspace.compiled(changed_only=not fresh)) if needs_build else None
    jobs = [(group, *requirements(group.lines)) for group in groups]
    if jobs and (bundled := own_wheels(ROOT)):
        say(f"the wheels of {bundled.relative_to(ROOT)} are whole: no network is asked")
    if fresh:
        say("from nothing this takes one to three minutes, with wheels from the network more")
        make_venv(prefix)
        STAMP_VENV.write_text(plan.venv)
    if parts:
        prepare_build()
        STAMP_BUILD.unlink(missing_ok=True)
    with ThreadPoolExecutor() as pool:
        installing = {group.name: pool.submit(install_wheels, group, *pip, prefix) for group, *pip in jobs}
        if BUILD_TOOLS in installing:
            installing[BUILD_TOOLS].result()
        building = []
        if parts:
            building.append(pool.submit(compile_packages, plan.workspace, parts))
            building.append(pool.submit(build_packages, plan.workspace))
        for job in installing.values():
            job.result()
        if installing:
            byte_compile()
        for job in building:
            job.result()
    if parts:
        STAMP_BUILD.write_text(plan.build)
    say(f"done in {time.monotonic() - begin_s:.0f} s")


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
