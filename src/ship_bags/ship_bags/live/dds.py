"""DDS set-up of a process before ROS starts: the suite's profile, and security if it is requested.

A process that is requested to use DDS security must not run without it. ROS uses security only if
``ROS_SECURITY_ENABLE`` is exactly ``true``; with ``TRUE`` or ``1`` ROS runs unprotected without a warning. The same
happens with the strategy ``Permissive`` if DDS was built without security.
"""

import mmap
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

from ship_bags.errors import BadInput

ENABLE, STRATEGY = "ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY"

_FALSE_VALUES = ("", "0", "false", "no", "off")
_LIBRARY = "libfastrtps."
_WITH_SECURITY, _WITHOUT_SECURITY = b"process_data_message_with_security", b"process_data_message_without_security"
"""Parts of symbol names that the library exports: the second always, the first only if built with security."""

DDS_PROFILE = Path(__file__).with_name("dds_profile.xml")
"""Fast DDS profile of every program of the suite, for discovery and retransmission; the file gives the reasons."""

PROFILE_VARIABLE, QOS_FROM_PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML"
"""Environment variable that names a profile, and the variable by which the profile applies to writers and readers too.
"""


def prepare_dds() -> None:
    """Prepare DDS before ROS starts: check requested security, set the profile; every program of the suite calls this.

    Raises:
        BadInput: DDS security is requested and not available.
    """
    require_security()
    use_dds_profile()


def use_dds_profile() -> None:
    """Set the suite's Fast DDS profile for this process and its child processes; a profile set by the user stays."""
    if os.environ.setdefault(PROFILE_VARIABLE, str(DDS_PROFILE)) == str(DDS_PROFILE):
        os.environ.setdefault(QOS_FROM_PROFILE_VARIABLE, "1")


def require_security() -> None:
    """Refuse to start if the environment requests DDS security and this installation does not have it.

    If the process may start, its environment gets the request in the spelling that ROS accepts.

    Raises:
        BadInput: see :func:`security_environment`.
    """
    if is_security_requested(os.environ):
        os.environ.update(security_environment(os.environ, dds_has_security(loaded_libraries())))


def is_security_requested(environment: Mapping[str, str]) -> bool:
    """Return True if an environment requests DDS security: by any text that does not mean "no"."""
    return environment.get(ENABLE, "").strip().lower() not in _FALSE_VALUES


def security_environment(environment: Mapping[str, str], has_security: bool | None) -> dict[str, str]:
    """Return the environment that requests DDS security in the spelling that ROS accepts.

    Args:
        environment: environment with the request.
        has_security: True if DDS was built with security; None if unknown.

    Raises:
        BadInput: DDS was built without security; or this is unknown, and the middleware would not refuse to start.
    """
    demand, enforced = environment[ENABLE], environment.get(STRATEGY, "").strip().lower() == "enforce"
    if has_security is False:
        raise BadInput(
            f"{ENABLE}={demand} requests DDS security, and this installation's DDS was built without security: "
            "not started, because it would run unprotected"
        )
    if has_security is None and not enforced:
        raise BadInput(
            f"{ENABLE}={demand} requests DDS security, and it is unknown whether this DDS has it: "
            f"set {STRATEGY}=Enforce, with which the middleware itself refuses to start"
        )
    return {ENABLE: "true"} | ({STRATEGY: "Enforce"} if enforced else {})


def dds_has_security(libraries: Iterable[Path]) -> bool | None:
    """Return True if the Fast DDS among some libraries was built with security; None if unknown."""
    for path in libraries:
        if not path.name.startswith(_LIBRARY):
            continue
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            if content.find(_WITH_SECURITY) >= 0:
                return True
            if content.find(_WITHOUT_SECURITY) >= 0:
                return False
    return None


def loaded_libraries() -> list[Path]:
    """Return the files from which this process has loaded Fast DDS; empty with another middleware."""
    get_rmw_implementation_identifier()  # loads the middleware
    lines = Path("/proc/self/maps").read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    return sorted({Path(line[line.index("/") :]) for line in lines if f"/{_LIBRARY}" in line})
