"""Bytes from and to instruments and bridge: split received bytes into lines, open serial devices, describe errors.

Some errors of opening a port, device or file disappear by waiting, for example a device that is not plugged in yet.
Other errors need the user: the node reports these errors at its start, with the parameter that names the place.
"""

import errno
import os
import re
import socket
import termios
from collections.abc import Mapping
from typing import Any

import serial

from ship_bags.errors import BadInput, one_line
from ship_bags.nmea.instrument_lines import LONGEST_LINE

_END = re.compile(rb"[\r\n]+")

_PERMANENT_ERRORS = (
    errno.EADDRINUSE, errno.EADDRNOTAVAIL, errno.EACCES, errno.EPERM, errno.EISDIR, errno.EROFS, errno.ENOTDIR,
    errno.EINVAL, errno.ENOTTY, errno.EAGAIN,
)  # fmt: skip
"""Errors that do not disappear by waiting."""

_ADVICE = {
    errno.EADDRINUSE: "another program uses it: end that program, or use another port",
    errno.EAGAIN: "another program uses it: end that program",
    errno.EADDRNOTAVAIL: "this machine has no such address",
    errno.ENOTTY: "not a serial device: expected for example /dev/ttyUSB0",
    errno.EACCES: "not permitted: ports below 1024 are privileged, use a higher one",
}
_ADVICE_BY_KIND = {
    ("serial", errno.EACCES): "not permitted: add this user to the group of the device, often 'dialout'",
    ("file", errno.EACCES): "not permitted: use a folder in which this user may write",
    ("serial", errno.EINVAL): "expected a rate that the device supports, for example 4800 or 38400",
}


class LineSplitter:
    """Splitter of a byte stream into lines; a line that is too long is cut, but a sentence at its end is kept."""

    def __init__(self) -> None:
        self._rest = b""
        self._is_skipping = False

    def split(self, data: bytes) -> list[bytes]:
        """Return the lines that end in ``data``, and the first :data:`LONGEST_LINE` + 1 bytes of a too long line."""
        *ended, rest = _END.split(self._rest + data)
        found: list[bytes] = []
        for line in ended:
            found += _split_long_line(line, self._is_skipping)
            self._is_skipping = False
        too_long, self._rest = _split_long_line(rest, self._is_skipping)
        self._is_skipping = bool(self._is_skipping or too_long) and not self._rest
        return [line for line in [*found, too_long] if line]

    def flush(self) -> list[bytes]:
        """Return the incomplete line at the end of a datagram or a connection, if any."""
        rest, self._rest, self._is_skipping = self._rest, b"", False
        return [rest] if rest else []


def _split_long_line(line: bytes, is_skipping: bool) -> tuple[bytes, bytes]:
    """Split a line that is too long into its first part, cut, and the sentence at its end.

    A sentence may follow binary data without a line end. A line that is not too long, and whose first part was not cut,
    is returned as the second part.

    Args:
        line: the line, or the part of it received so far.
        is_skipping: True if the first part of the line was already cut.
    """
    if len(line) <= LONGEST_LINE and not is_skipping:
        return b"", line
    start = line.rfind(b"$")
    if start < 0 or len(line) - start > LONGEST_LINE:
        start = len(line)
    return b"" if is_skipping else line[:start][: LONGEST_LINE + 1], line[start:]


def open_serial(device: str, baud: int, wait_s: float) -> serial.Serial:
    """Open a serial device for exclusive use: 8 data bits, no parity, one stop bit, as in NMEA 0183.

    Args:
        device: path of the device.
        baud: bits per second.
        wait_s: timeout of a read for the first byte, s.

    Raises:
        OSError: the device cannot be opened; the error number is always set, also if pyserial omits it.
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


def error_text(problem: Exception) -> str:
    """Return the text of an error in one line, without the additions of pyserial or other libraries."""
    if isinstance(problem, OSError) and problem.errno and not isinstance(problem, socket.gaierror):
        return os.strerror(problem.errno)
    return one_line(getattr(problem, "strerror", None) or str(problem) or type(problem).__name__)


def permanent_error(
    problem: Exception, prefix: str, config: Any, parameter_names: Mapping[str, tuple[str, str]]
) -> BadInput | None:
    """Return the error of a first opening as BadInput; None if the error may disappear by waiting.

    Args:
        problem: exception raised by the opening.
        prefix: prefix of the names of the place's parameters, for example ``"sinks.bridge"``.
        config: parameters of the place, with its ``kind``.
        parameter_names: kind → parameter that names the place, and parameter of the own address or of the rate.
    """
    number = (isinstance(problem, OSError) and problem.errno) or 0
    is_unresolved = isinstance(problem, socket.gaierror)
    if not is_unresolved and number not in _PERMANENT_ERRORS:
        return None
    is_address_or_rate = is_unresolved or number in (errno.EADDRNOTAVAIL, errno.EINVAL)
    parameter = parameter_names[config.kind][is_address_or_rate]
    value = getattr(config, parameter)
    to_do = _ADVICE_BY_KIND.get((config.kind, number)) or _ADVICE.get(number)
    advice = f": {to_do}" if to_do else ""
    name = f"{prefix}.{parameter}"
    return BadInput(f"parameter '{name}' = {value!r}: {error_text(problem)}{advice}", parameters=(name,), value=value)
