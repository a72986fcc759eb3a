"""The demand for DDS security in a ship's profile, and the items that the process's environment lacks for security.

The profile is the file of the ship's limits, key ``machine.require_security``. The demand fails closed: an item that
cannot be determined counts as absent.
"""

import os
from collections.abc import Mapping
from pathlib import Path

from ship_bags.errors import BadInput
from ship_bags.live.ros_process import ENABLE, STRATEGY, is_security_requested
from ship_watch.safety.limits import Limits

KEYSTORE = "ROS_SECURITY_KEYSTORE"
ENCLAVE = "ROS_SECURITY_ENCLAVE_OVERRIDE"
"""Environment variable with the enclave of a process; without this variable ROS uses the enclave ``/``."""

DOMAIN, LAST_DOMAIN = "ROS_DOMAIN_ID", 232

_ENFORCE = "Enforce"


def security_problems(environment: Mapping[str, str], has_security: bool | None) -> list[tuple[str, str]]:
    """Return the reasons why DDS security is not available and enforced, each with advice.

    Args:
        environment: environment of the process.
        has_security: True if DDS was built with security (:func:`ship_bags.live.ros_process.dds_has_security`); None if
            unknown.
    """
    found = []
    if has_security is not True:
        is_missing = has_security is False
        why = "this installation's DDS was built without security" if is_missing else "unknown for this DDS"
        found.append((f"no DDS security: {why}", "use the Ubuntu packages of ROS 2 Jazzy, which have DDS security"))
    if not is_security_requested(environment):
        given = environment.get(ENABLE)
        found.append((f"{ENABLE} is {given or 'not set'}: nodes run unprotected", f"export {ENABLE}=true"))
    strategy = environment.get(STRATEGY)
    if strategy != _ENFORCE:
        text = f"{STRATEGY} is {strategy or 'not set'}: a node without an enclave runs unprotected"
        found.append((text, f"export {STRATEGY}={_ENFORCE}"))
    keystore = environment.get(KEYSTORE, "")
    if not keystore:
        found.append((f"{KEYSTORE} is not set", f"export {KEYSTORE}=FOLDER: the ship's keystore"))
    elif not Path(keystore).is_dir():
        found.append((f"{KEYSTORE}={keystore} is not a folder", f"export {KEYSTORE}=FOLDER: the ship's keystore"))
    return found


def require_profile(limits: Limits, limits_path: Path | None, has_security: bool | None) -> None:
    """Refuse to start if the ship's profile demands DDS security and this security is not available and enforced.

    Args:
        limits: limits of the ship.
        limits_path: file of the limits; None for the defaults.
        has_security: see :func:`security_problems`.

    Raises:
        BadInput: security is demanded, but an item is missing; the text contains file, key and first missing item.
    """
    if not limits.machine.require_security:
        return
    found = security_problems(os.environ, has_security)
    if found:
        text, advice = found[0]
        more = f" (and {len(found) - 1} more: see ship_bringup preflight)" if len(found) > 1 else ""
        reason = f"machine.require_security is true, and {text}: not started; {advice}{more}"
        raise BadInput(reason, file=limits_path)


def domain_of(environment: Mapping[str, str]) -> int:
    """Return the domain in an environment; 0 if the environment contains no valid domain."""
    text = environment.get(DOMAIN, "")
    return int(text) if text.isascii() and text.isdigit() and int(text) <= LAST_DOMAIN else 0


def enclave_command(enclave: str) -> tuple[str, ...]:
    """Return the prefix of a command that gives its process an enclave.

    The prefix sets a variable, because a program may create its nodes in contexts that no argument reaches. The
    process id stays the same.
    """
    return ("/usr/bin/env", f"{ENCLAVE}={enclave}")
