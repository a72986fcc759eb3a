"""What DDS needs before ROS starts in a process: the suite's profile, and security where it is demanded.

DDS security fails closed: a process that is told to use it must not run without it. ROS takes ``ROS_SECURITY_ENABLE``
for set where it is exactly ``true``, and runs unprotected, without a word, where it is ``TRUE`` or ``1``; with the
strategy ``Permissive`` also where DDS was built without security.
"""

import mmap
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

from ship_bags.errors import BadInput

ENABLE, STRATEGY = "ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY"

_NOT_DEMANDED = ("", "0", "false", "no", "off")
_LIBRARY = "libfastrtps."
_WITH, _WITHOUT = b"process_data_message_with_security", b"process_data_message_without_security"
"""Parts of names that the library exports: the second always, the first only where it was built with security."""

DDS_PROFILE = Path(__file__).with_name("dds_profile.xml")
"""How Fast DDS meets others and repeats what was lost, in every program of the suite: the reasons stand in the file."""

PROFILE_VARIABLE, QOS_FROM_PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML"
"""Environment that names a profile, and that lets it count for writers and readers, too."""


def prepare_dds() -> None:
    """What every program of the suite does before ROS starts in it: security is there or not demanded, and the profile.

    Raises:
        BadInput: DDS security is demanded and not there.
    """
    require_demanded_security()
    use_dds_profile()


def use_dds_profile() -> None:
    """Give the suite's profile of Fast DDS to this process, and to those that it starts; one that people set rules."""
    if os.environ.setdefault(PROFILE_VARIABLE, str(DDS_PROFILE)) == str(DDS_PROFILE):
        os.environ.setdefault(QOS_FROM_PROFILE_VARIABLE, "1")


def require_demanded_security() -> None:
    """Refuse to start where the environment demands DDS security and this installation cannot give it.

    Where it can, the process's environment gets the demand in the spelling that ROS understands.

    Raises:
        BadInput: see :func:`spelled_demand`.
    """
    if is_demanded(os.environ):
        os.environ.update(spelled_demand(os.environ, dds_has_security(loaded_libraries())))


def is_demanded(environment: Mapping[str, str]) -> bool:
    """Whether an environment asks for DDS security: by any text that is not clearly a no."""
    return environment.get(ENABLE, "").strip().lower() not in _NOT_DEMANDED


def spelled_demand(environment: Mapping[str, str], has_security: bool | None) -> dict[str, str]:
    """A demand for DDS security as ROS understands it.

    Args:
        environment: makes the demand.
        has_security: whether DDS was built with security; None where that cannot be told.

    Raises:
        BadInput: it was not; or it cannot be told, and the middleware would not refuse by itself.
    """
    demand, enforced = environment[ENABLE], environment.get(STRATEGY, "").strip().lower() == "enforce"
    if has_security is False:
        raise BadInput(
            f"{ENABLE}={demand} demands DDS security, and the DDS of this installation was built without it: "
            "not started, as it would run unprotected"
        )
    if has_security is None and not enforced:
        raise BadInput(
            f"{ENABLE}={demand} demands DDS security, and whether this DDS has it cannot be told: "
            f"set {STRATEGY}=Enforce, with which the middleware itself refuses"
        )
    return {ENABLE: "true"} | ({STRATEGY: "Enforce"} if enforced else {})


def dds_has_security(libraries: Iterable[Path]) -> bool | None:
    """Whether the Fast DDS among some libraries was built with security; None where that cannot be told."""
    for path in libraries:
        if not path.name.startswith(_LIBRARY):
            continue
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            if content.find(_WITH) >= 0:
                return True
            if content.find(_WITHOUT) >= 0:
                return False
    return None


def loaded_libraries() -> list[Path]:
    """Files from which this process has loaded Fast DDS; empty where it uses another middleware."""
    get_rmw_implementation_identifier()  # which loads it
    lines = Path("/proc/self/maps").read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    return sorted({Path(line[line.index("/") :]) for line in lines if f"/{_LIBRARY}" in line})
