"""Outlets to devices of this machine: a serial line, and a file."""

import contextlib
import errno
import os
import selectors
import termios

import serial

from ship_nmea.line_splitter import LineSplitter
from ship_nmea.link_opening import open_serial
from ship_nmea.out.outlet import RECEIVE_BYTES, Outlet, command_texts

_MAX_UNSENT_S = 0.1
"""Maximum transmission time of the unsent data of a serial line, s; with more unsent data, no sentence is accepted."""
_BITS_PER_BYTE = 10


class SerialOutlet(Outlet):
    """A serial line; it accepts the next sentence when the previous sentence is nearly sent."""

    _port: serial.Serial | None = None

    def open(self, selector: selectors.BaseSelector) -> None:
        """See :meth:`Outlet.open`."""
        config = self._config
        self._splitter = LineSplitter()
        self._unsent = b""
        self._port = open_serial(config.device, config.baud, wait_s=0.0)
        selector.register(self._port.fileno(), selectors.EVENT_READ, self._read)

    def send(self, sentence: bytes) -> bool:
        """See :meth:`Outlet.send`."""
        assert self._port is not None
        if self._unsent:
            self._write()
        if self._unsent or self._port.out_waiting > self._config.baud / _BITS_PER_BYTE * _MAX_UNSENT_S:
            return False
        self._unsent = sentence
        self._write()
        return True

    def close(self) -> None:
        """See :meth:`Outlet.close`."""
        if self._port is not None:
            # Closing would wait for unsent data of a lost line.
            with contextlib.suppress(OSError, termios.error):
                self._port.reset_output_buffer()
            with contextlib.suppress(OSError, termios.error):
                self._port.close()
            self._port = None

    def _write(self) -> None:
        assert self._port is not None
        with contextlib.suppress(BlockingIOError):
            self._unsent = self._unsent[os.write(self._port.fileno(), self._unsent) :]

    def _read(self) -> None:
        assert self._port is not None
        data = os.read(self._port.fileno(), RECEIVE_BYTES)
        if not data:
            raise OSError(errno.EIO, "the device is gone")
        for line in command_texts(self._splitter.split(data)):
            self._receive(line, "")


class FileOutlet(Outlet):
    """A file to which whole sentences are appended."""

    _file: int | None = None

    def open(self, _selector: selectors.BaseSelector) -> None:
        """See :meth:`Outlet.open`."""
        # Opening a pipe without O_NONBLOCK would wait for a reader.
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK
        self._file = os.open(self._config.path, flags, 0o644)
        os.set_blocking(self._file, True)

    def send(self, sentence: bytes) -> bool:
        """See :meth:`Outlet.send`."""
        assert self._file is not None
        written = os.write(self._file, sentence)
        if written < len(sentence):
            # The disk is full: an incomplete sentence would precede the next sentence.
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, os.fstat(self._file).st_size - written)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return True

    def close(self) -> None:
        """See :meth:`Outlet.close`."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                os.close(self._file)
            self._file = None
