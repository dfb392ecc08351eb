"""Files, the rim of the program: whole or not at all, and what goes wrong is the user's to read in one line.

Laws kept here: a file appears complete under its name or not at all (written beside, synced, renamed); whether a
folder can be written is found out before the work, not after it.
"""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from agent.errors import UserError


def write_whole(path: Path, data: bytes) -> None:
    """Write a file, replacing one of that name; at any instant, even of a power cut, it is the old one or the new.

    Raises:
        UserError: the folder is missing or not writable, the disk is full, the name is that of a folder.
    """
    try:
        beside = path.with_name(f".orion-{secrets.token_hex(8)}.tmp")
        try:
            # "x": never into a file or through a link that is there already.
            with beside.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                beside.unlink()
            raise
        _sync_folder(path.parent)
    except (OSError, ValueError) as error:
        raise UserError(
            path, f"cannot be written: {_reason(error)}", "choose another place or free this one"
        ) from error


def prepare_folder(path: Path) -> Path:
    """Make an output folder, if need be with its parents, and prove that files can be made in it.

    Returns:
        The folder's absolute path, so that a later change of the working directory does not move it.

    Raises:
        UserError: it cannot be made or written.
    """
    try:
        folder = path.absolute()
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".orion-{secrets.token_hex(8)}.tmp"
        probe.touch(exist_ok=False)
        probe.unlink()
    except (OSError, ValueError) as error:
        raise UserError(path, f"is no folder to write to: {_reason(error)}", "choose another folder") from error
    return folder


def read_bytes(path: Path) -> bytes:
    """The content of a file.

    Raises:
        UserError: it is missing, a folder, or not readable.
    """
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise UserError(path, f"cannot be read: {_reason(error)}", "check the path") from error


def _sync_folder(folder: Path) -> None:
    """Make the renaming itself survive a power cut; a file system that cannot do so loses nothing else."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _reason(error: Exception) -> str:
    """The system's own words without its error number and path; ValueError is a name with a zero byte."""
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
