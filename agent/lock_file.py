"""One process at a time: a lock that ends when its process does, however that ends."""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path

from agent.errors import UserError


class LockFile:
    """A lock held from the moment it is made until ``close``, or until the process is gone.

    The file stays: if it were deleted, two processes could each hold the lock of a file that was once called so.

    Raises:
        UserError: another process holds it.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor: int | None = None
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError:
            return  # where no file can be made nobody writes: there is nothing to guard
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(descriptor, 20).decode(errors="replace").strip()
            os.close(descriptor)
            what = f"is held by process {holder}" if holder else "is held by another process"
            raise UserError(path, what, "end that one, or give another --state") from None
        except OSError:  # a file system without locks
            os.close(descriptor)
            return
        self._descriptor = descriptor
        with contextlib.suppress(OSError):  # a full disk: the lock holds, only its holder has no name
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, b"%d\n" % os.getpid(), 0)

    def close(self) -> None:
        """Let others have it."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
