"""A serial port that is kept open: a thread reads it, and opens it again when it goes.

Laws kept here: no failure of the port raises, it is told; the port is opened, read and closed by one thread only, and
written by any, never while it is being closed; a write takes no longer than its timeout (pyserial's rfc2217 knows none
and allows itself five seconds).
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Protocol

import serial

_READ_TIMEOUT = 0.2
"""Seconds after which a read looks up, for the handlers that cannot cancel one (socket://, rfc2217://)."""


class Listener(Protocol):
    """Who hears of a line; all of it on the line's thread, in order."""

    def line_opened(self) -> None:
        """The port is open."""
        ...

    def line_read(self, chunk: bytes) -> None:
        """These bytes came."""
        ...

    def line_lost(self, reason: str) -> None:
        """The port is gone, or was not there to begin with. Told once, however often it is tried in vain."""
        ...


class SerialLine:
    """One port, open whenever it can be.

    Args:
        url: a device or anything ``serial.serial_for_url`` takes: ``/dev/serial/by-id/...``, ``loop://``,
            ``socket://host:port``, ``rfc2217://host:port``. By-id names survive replugging, ``/dev/ttyACM0`` may not.
        listener: who is told.
        baudrate: bits a second; USB, pseudo-terminals and sockets ignore it.
        write_timeout: seconds that a write may take.
        retry: seconds until a lost port is tried again: at first, and at most; it doubles in between.

    Raises:
        ValueError: nothing could ever be opened under such a URL.
    """

    def __init__(
        self,
        url: str,
        listener: Listener,
        *,
        baudrate: int,
        write_timeout: float,
        retry: tuple[float, float],
    ) -> None:
        self._url = url
        self._listener = listener
        self._baudrate = baudrate
        self._write_timeout = None if url.startswith("rfc2217:") else write_timeout  # which refuses to have one
        self._new_port(do_not_open=True)
        self._retry = retry
        self._port: serial.Serial | None = None
        self._port_lock = threading.Lock()  # held while writing, and to let go of the port
        self._clogged = False
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"orion-serial {url}", daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> bool:
        """Give the bytes to the port; whether it is open and took them all within the timeout."""
        with self._port_lock:
            if self._port is None:
                return False
            try:
                self._clogged = self._port.write(data) != len(data)
            except Exception:  # each of pyserial's handlers raises something else: SerialException, queue.Full, ...
                self._clogged = True
            return not self._clogged

    def close(self) -> None:
        """Close the port for good and end the thread. Safe to call twice, but not on the line's own thread."""
        self._closing.set()
        with self._port_lock, contextlib.suppress(AttributeError, OSError):
            self._port.cancel_read()  # type: ignore[union-attr]  # there may be no port, or one that cannot
        self._thread.join()

    def _run(self) -> None:
        wait, told = self._retry[0], False
        while not self._closing.is_set():
            try:
                port = self._open()
                told = False
                self._listener.line_opened()
                while not self._closing.is_set():
                    if chunk := _read(port):
                        wait = self._retry[0]  # a port that opens and then says nothing is in no hurry
                        self._listener.line_read(chunk)
            except _GoneError as gone:
                self._let_go()
                if not told:
                    told = True
                    self._listener.line_lost(str(gone))
                self._closing.wait(wait)
                wait = min(2 * wait, self._retry[1])
        self._let_go()

    def _new_port(self, *, do_not_open: bool = False) -> serial.Serial:
        return serial.serial_for_url(
            self._url,
            self._baudrate,
            do_not_open=do_not_open,
            timeout=_READ_TIMEOUT,
            write_timeout=self._write_timeout,
            exclusive=True,  # a second agent on the same robot is refused instead of stealing every other byte
        )

    def _open(self) -> serial.Serial:
        with _anything_means_gone():
            port = self._new_port()
        with self._port_lock:
            self._port = port
            self._clogged = False
        return port

    def _let_go(self) -> None:
        with self._port_lock:
            port, self._port = self._port, None
        if port is None:
            return
        left_open = getattr(port, "_socket", None)  # by pyserial's socket://, if the other side hung up first
        with contextlib.suppress(Exception):
            if self._clogged:  # else the kernel waits up to 30 s for what nobody will read
                port.reset_output_buffer()
        with contextlib.suppress(Exception):
            port.close()
        if left_open is not None:
            left_open.close()


class _GoneError(Exception):
    """The port failed, for this reason."""


@contextlib.contextmanager
def _anything_means_gone() -> Iterator[None]:
    try:
        yield
    except Exception as error:  # OSError, SerialException, termios.error, TypeError: whatever a vanishing port causes
        raise _GoneError(str(error) or type(error).__name__) from error


def _read(port: serial.Serial) -> bytes:
    with _anything_means_gone():
        first = port.read(1)
        waiting = port.in_waiting if first else 0
        return first + port.read(waiting) if waiting else first
