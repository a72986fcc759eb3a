"""Set up this checkout: virtual environment, pinned wheels, compiled modules, messages, packages.

Each step writes a stamp when it is done. A second run therefore takes a moment, a change repeats only the steps that
depend on it, and an interrupted run is completed by running it again. If the user must act, setup prints one line
and exits with code 2. ``--all`` also installs the wheels that few people use (section ``[all]`` of
requirements.lock).

ROS 2 Jazzy is installed as wheels into the virtual environment. If a Jazzy installation is sourced, it replaces these
wheels, and the virtual environment on top of it has only the other wheels.

Independent steps run in parallel. The wheels of ROS and of the build tools are first; messages and modules are compiled
while the other wheels are installed.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

from prebuilt import digest
from setup_build import (
    CompiledParts,
    Workspace,
    build_packages,
    compile_packages,
    compiled_parts,
    prepare_build,
    read_workspace,
)
from setup_common import BUILD, ROOT, VENV, SetupError, end_commands, print_progress, read_stamp
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

from wheelhouse import LOCK, WheelsRefused, locked_requirements, own_target, own_wheels

STAMP_VENV = VENV / ".stamp_venv"
STAMP_BUILD = BUILD / ".stamp_build"
COLCON_META = ROOT / "colcon.meta"

Job: TypeAlias = tuple[Group, list[str], list[str]]
"""A group of wheels, lines for pip, and pip's options for the location of the wheels."""


@dataclass(frozen=True)
class Plan:
    """The parts to set up, with the digests that identify an existing part.

    Attributes:
        workspace: the packages to build.
        groups: the groups of wheels.
        venv: digest of the inputs of the virtual environment.
        build: digest of the sources of all built parts.
    """

    workspace: Workspace
    groups: list[Group]
    venv: str
    build: str

    @property
    def fresh(self) -> bool:
        """True if setup starts from nothing.

        A group without a stamp (except ``ALL_OTHER``) counts as missing, because a partly installed group looks like a
        complete group. Wheels of an older lock may hide packages of a sourced Jazzy installation; setup then also
        starts from nothing.
        """
        done = {group.name: read_stamp(group.stamp) for group in self.groups}
        if read_stamp(STAMP_VENV) != self.venv or not all(stamp for name, stamp in done.items() if name != ALL_OTHER):
            return True
        return bool(self.workspace.prefix) and any(done[group.name] not in ("", group.digest) for group in self.groups)


def make_plan(everything: bool = False) -> Plan:
    """Return the plan for this checkout and machine.

    Args:
        everything: True to include the wheels that few people use.
    """
    lock = locked_requirements((ROOT / LOCK).read_text(encoding="utf-8"))
    prefix = ros_prefix() or (read_stamp(ROS_PREFIX_FILE) if os.environ.get("ROS_DISTRO") is None else "")
    venv = digest(str(ROOT), f"{sys.version_info[:2]}", prefix)
    groups = [
        Group(name, lines_to_install(lock, sections, prefix), venv)
        for name, sections in SECTIONS_OF_GROUPS.items()
        if everything or name != ALL_OTHER
    ]
    meta = COLCON_META.read_text(encoding="utf-8") if COLCON_META.exists() else ""
    ros = "an installed ROS" if prefix else "ROS as wheels"
    workspace = read_workspace(prefix, "\n".join([own_target(), ros, *lock["ros"], *lock["build"], meta]))
    wheels = [group.digest for group in groups if group.name != ALL_OTHER]
    packages = [f"{folder.name} {content}" for folder, content in workspace.digests.items()]
    return Plan(workspace, groups, venv, digest(*wheels, *packages))


def set_up(everything: bool) -> None:
    """Run all steps, each only if needed."""
    begin_s = time.monotonic()
    plan = make_plan(everything)
    is_fresh, prefix = plan.fresh, plan.workspace.prefix
    groups = [group for group in plan.groups if is_fresh or not group.is_installed]
    to_compile = plan.workspace.compiled_packages(changed_only=not is_fresh)
    needs_build = bool(to_compile) or read_stamp(STAMP_BUILD) != plan.build
    if not groups and not needs_build:
        return
    check_machine(groups if is_fresh else [group for group in groups if group.name == ALL_OTHER])
    parts = compiled_parts(to_compile) if needs_build else None
    jobs = [(group, *requirements(group.lines)) for group in groups]
    if jobs and (bundled := own_wheels(ROOT)):
        print_progress(f"the wheels of {bundled.relative_to(ROOT)} are complete: no network is used")
    if is_fresh:
        print_progress("the first setup takes one to three minutes, more with wheels from the network")
        make_venv(prefix)
        STAMP_VENV.write_text(plan.venv)
    if parts:
        prepare_build()
        STAMP_BUILD.unlink(missing_ok=True)
    install_and_build(plan.workspace, jobs, parts)
    if parts:
        STAMP_BUILD.write_text(plan.build)
    print_progress(f"done in {time.monotonic() - begin_s:.0f} s")


def install_and_build(workspace: Workspace, jobs: list[Job], parts: CompiledParts | None) -> None:
    """Install wheels, and build as soon as the build tools are installed; a step that fails ends the other steps.

    Args:
        workspace: the packages to build.
        jobs: each group of wheels to install, with lines and options for pip.
        parts: compiled parts to build; None if nothing is to be built.
    """
    with ThreadPoolExecutor(max_workers=8) as pool:  # some jobs wait for other jobs
        installing = {group.name: pool.submit(install_wheels, group, *pip, workspace.prefix) for group, *pip in jobs}

        def build(step: Callable[[], None]) -> None:
            if BUILD_TOOLS in installing:
                installing[BUILD_TOOLS].result()
            step()

        def finish_wheels() -> None:
            for group in installing.values():
                group.result()
            byte_compile()

        steps = [pool.submit(finish_wheels)] if installing else []
        if parts:
            steps.append(pool.submit(build, partial(compile_packages, workspace, parts)))
            steps.append(pool.submit(build, partial(build_packages, workspace)))
        try:
            for step in as_completed([*installing.values(), *steps]):
                step.result()
        except BaseException:
            end_commands()
            raise


def main() -> int:
    """Set up under a lock, which excludes a second call at the same time."""
    parser = argparse.ArgumentParser(prog="setup", description=__doc__, allow_abbrev=False)
    parser.add_argument("--all", action="store_true", help="also the wheels that few people use")
    options = parser.parse_args()
    try:
        with (ROOT / ".setup.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                print_progress("waiting for another setup of this checkout")
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
