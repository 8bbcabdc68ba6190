"""Files that are there as a whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from canfb.commissioning.access import CommissioningError


def write_whole(path: Path, data: bytes) -> None:
    """Write or replace a file. CommissioningError in one line; what was there before is there still.

    What is no plain file, as /dev/stdout or a pipe, is written to as it is.
    """
    try:
        if path.exists() and not path.is_file():
            _write_through(path, data)
        else:
            _replace(path, data)
    except OSError as error:
        raise CommissioningError(f"cannot write {path}: {error.strerror or error}") from None


def check_writable(path: Path) -> None:
    """CommissioningError where the file cannot be made, before any work is done for it."""
    if path.is_dir():
        raise CommissioningError(f"cannot write {path}: it is a folder")
    if not path.parent.is_dir():
        raise CommissioningError(f"cannot write {path}: there is no folder {path.parent}")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise CommissioningError(f"cannot write {path}: Permission denied")


def _write_through(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)


def _replace(path: Path, data: bytes) -> None:
    target = path.resolve()  # a link stays one
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask())
        os.replace(name, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise


def _umask() -> int:
    before = os.umask(0o022)
    os.umask(before)
    return before
