"""The serial ports of simulated robots: a pseudo-terminal for each, and a link to it whose name stays the same.

Laws kept here: a link is there as long as its port is, and no longer; a link that a killed run left behind is replaced,
a file that is none is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from agent.errors import UserError
from transport.mcu_port import McuPort


class McuPorts:
    """Ports for robots, in their order. Use it in a ``with`` statement.

    Args:
        folder: where the links are made: ``r1.tty`` for robot r1.
        robots: their ids.

    Attributes:
        links: where each robot's port is found.
        ports: the ends that the microcontrollers speak at.
    """

    def __init__(self, folder: Path, robots: Sequence[str]) -> None:
        self.links = {robot: folder.absolute() / f"{robot}.tty" for robot in robots}
        self.ports: list[McuPort] = []

    def __enter__(self) -> Self:
        try:
            for link in self.links.values():
                self.ports.append(McuPort.open_pty())
                _link(link, self.ports[-1].path)
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def _close(self) -> None:
        for link, port in zip(self.links.values(), self.ports, strict=False):
            if link.is_symlink() and str(link.readlink()) == port.path:  # else a later run has made it its own
                link.unlink()
            port.close()


def _link(link: Path, target: str) -> None:
    """Make the link.

    Raises:
        UserError: something that is no link bears its name, or the folder cannot be written.
    """
    try:
        if link.is_symlink():
            link.unlink()
        link.symlink_to(target)
    except FileExistsError:
        raise UserError(link, "is a file, and a robot's port is to have that name", "move it away") from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise UserError(link, f"cannot be made: {reason}", "put the configuration in another folder") from error
