"""Ports, devices and files where sentences come in or go out: opening them, and what is wrong with one, in plain words.

Some problems go away by waiting: a plug is put in. Others somebody has to put right: the node says so at its start,
with the parameter that names the place.
"""

import errno
import os
import socket
import termios
from collections.abc import Mapping
from typing import Any

import serial

from ship_bags.errors import BadInput, one_line

_HOPELESS = (
    errno.EADDRINUSE, errno.EADDRNOTAVAIL, errno.EACCES, errno.EPERM, errno.EISDIR, errno.EROFS, errno.ENOTDIR,
    errno.EINVAL, errno.ENOTTY, errno.EAGAIN,
)  # fmt: skip
"""What does not go away by waiting."""

_TO_DO = {
    errno.EADDRINUSE: "another program has it: end that one, or give another port",
    errno.EAGAIN: "another program has it: end that one",
    errno.EADDRNOTAVAIL: "this machine has no such address",
    errno.ENOTTY: "it is no serial device: expected one as /dev/ttyUSB0",
    errno.EACCES: "this user may not: a port below 1024 needs a right of its own, give another one",
}
_TO_DO_OF_KIND = {
    ("serial", errno.EACCES): "this user may not: join the group of the device, often 'dialout'",
    ("file", errno.EACCES): "this user may not: give a folder in which it may write",
    ("serial", errno.EINVAL): "expected a rate that the device knows, as 4800 or 38400",
}


def opened_serial(device: str, baud: int, wait_s: float) -> serial.Serial:
    """A serial device, 8 data bits, no parity, one stop bit, as NMEA 0183 has it; nobody else may open it meanwhile.

    Args:
        device: its path.
        baud: bits per second.
        wait_s: how long a read waits for the first byte.

    Raises:
        OSError: it cannot be opened; always with its number, which pyserial leaves out at times.
    """
    try:
        return serial.Serial(device, baud, timeout=wait_s, write_timeout=0, exclusive=True)
    except termios.error as problem:
        raise OSError(*problem.args) from problem
    except serial.SerialException as problem:
        if problem.errno is None and isinstance(problem.__context__, termios.error):
            raise OSError(*problem.__context__.args) from problem
        raise
    except ValueError as problem:
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL)) from problem


def words(problem: Exception) -> str:
    """What is wrong, in one line, without what a library puts around it."""
    if isinstance(problem, OSError) and problem.errno and not isinstance(problem, socket.gaierror):
        return os.strerror(problem.errno)
    return one_line(getattr(problem, "strerror", None) or str(problem) or type(problem).__name__)


def refusal(problem: Exception, prefix: str, config: Any, named_by: Mapping[str, tuple[str, str]]) -> BadInput | None:
    """What to tell of a first opening that waiting would not mend; None where it may go away by itself.

    Args:
        problem: what opening raised.
        prefix: of the names of the place's parameters, as ``"sinks.bridge"``.
        config: parameters of the place, with its ``kind``.
        named_by: kind → the parameter that names the place, and the one that holds its own address, or its rate.
    """
    number = (isinstance(problem, OSError) and problem.errno) or 0
    is_unresolved = isinstance(problem, socket.gaierror)
    if not is_unresolved and number not in _HOPELESS:
        return None
    is_there = is_unresolved or number in (errno.EADDRNOTAVAIL, errno.EINVAL)
    parameter = named_by[config.kind][is_there]
    value = getattr(config, parameter)
    to_do = _TO_DO_OF_KIND.get((config.kind, number)) or _TO_DO.get(number)
    advice = f": {to_do}" if to_do else ""
    name = f"{prefix}.{parameter}"
    return BadInput(f"parameter '{name}' = {value!r}: {words(problem)}{advice}", parameters=(name,), value=value)
