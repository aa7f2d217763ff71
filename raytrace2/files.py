"""Whole files in and out: reading refuses what is not a regular file, writing never leaves half a file behind."""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path

from .errors import FileError


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """The bytes of the regular file ``path``; :class:`FileError` if it is missing, unreadable or not a regular file."""
    name = os.fspath(path)
    try:
        # A device or a pipe could be endless, and a blocked open() could not be interrupted.
        if not stat.S_ISREG(os.stat(name).st_mode):
            raise FileError("this is not a regular file", name, remedy="give the path of a file")
        return Path(name).read_bytes()
    except FileNotFoundError:
        raise FileError("there is no such file", name, remedy="check the path") from None
    except (OSError, ValueError, MemoryError) as error:
        if isinstance(error, FileError):
            raise
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        remedy = "check the path and its permissions"
        raise FileError(f"the file cannot be read: {reason}", name, remedy=remedy) from None


def write_atomically(path: str | os.PathLike[str], data: bytes) -> None:
    """Write ``data`` to ``path`` so that readers see either the old file or the whole new one, whatever interrupts us.

    :class:`FileError` if the folder is missing or cannot be written.
    """
    name = os.fspath(path)
    folder = os.path.dirname(os.path.abspath(name))
    temporary: str | None = None
    try:
        unfinished = os.path.join(folder, f".{os.path.basename(name)[:80]}.{secrets.token_hex(8)}.part")
        with open(unfinished, "xb") as stream:
            temporary = unfinished
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, name)
        temporary = None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        remedy = "check that the folder exists, may be written and has room"
        raise FileError(f"the file cannot be written: {reason}", name, remedy=remedy) from None
    finally:
        if temporary is not None and os.path.exists(temporary):
            os.unlink(temporary)
