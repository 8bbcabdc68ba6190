"""Files: where they can be, and written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from canfb.errors import CanfbError, ConfigError, saying

UTF_16 = (b"\xff\xfe", b"\xfe\xff")  # its marks
REPORT = "report.html"  # of calibrate, commission and demo; its last line says of which


def read_bytes(path: Path, refuse: type[Exception]) -> bytes:
    """``refuse`` is raised, in one line."""
    with saying(refuse, f"{path}: cannot be read", OSError):
        return path.read_bytes()


def decoded(data: bytes) -> str:
    """As text: UTF-8, UTF-16 with its mark, else Windows-1252, in which instruments write units."""
    encoding = "utf-16" if data[:2] in UTF_16 else "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def as_utf8(text: str) -> str:
    """Escape what is no UTF-8."""
    return text.encode(errors="backslashreplace").decode()


def check_writable(path: Path, option: str = "") -> None:
    """ConfigError, with the ``option``, where no file can be."""
    name = f"{option} {path}".strip()
    with saying(ConfigError, f"{name}: cannot be written", OSError):
        if path.is_dir():
            raise ConfigError(f"{name}: cannot be written: it is a folder")
        is_small = path.is_file() and path.stat().st_size < 1 << 16  # as a configuration is
        if is_small and re.search(rb"^(bus|modules|interfaces):", path.read_bytes(), re.MULTILINE):
            raise ConfigError(f"{name}: is a configuration, and would be replaced: give another name")
        if not path.parent.is_dir():
            raise ConfigError(f"{name}: there is no folder {path.parent}")
        if not os.access(path if path.exists() else path.parent, os.W_OK):
            raise ConfigError(f"{name}: cannot be written: Permission denied")


def writing(path: Path, option: str = "") -> contextlib.AbstractContextManager[None]:
    """CanfbError, with the ``option``, for an OSError within."""
    return saying(CanfbError, f"{option} {path}".strip() + ": cannot be written", OSError)


def prepare_folder(folder: Path, command: str, *kept: str) -> None:
    """CanfbError where no file can be; ConfigError with ``kept`` or the report of another ``command``."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name in kept:
            if (folder / name).exists():
                raise ConfigError(f"--out {folder}: has {name} of another measurement: give another folder")
        report = folder / REPORT
        if report.exists() and f"Made by canfb {command}".encode() not in report.read_bytes():
            raise ConfigError(f"--out {folder}: has {REPORT} of another command: give another folder")
        tempfile.TemporaryFile(dir=folder).close()


@contextlib.contextmanager
def replacing(path: Path, *, private: bool = False) -> Iterator[Path]:
    """A file that takes the place of ``path`` at the end; OSError leaves what was.

    ``private``: nobody else may read it.
    """
    target = path if private else path.resolve()  # a link stays one, but where anybody may have put it
    handle, name = tempfile.mkstemp("".join(target.suffixes), f".{target.name}.", target.parent)
    part = Path(name)
    try:
        yield part
        os.fsync(handle)
        if not private:
            part.chmod(target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask())
        part.replace(target)
    finally:
        os.close(handle)
        part.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes) -> None:
    """Replace a file, whole; a pipe is written to. CanfbError leaves what was."""
    with writing(path):
        if path.exists() and not path.is_file():
            path.write_bytes(data)
        else:
            with replacing(path) as part:
                part.write_bytes(data)


def _umask() -> int:
    before = os.umask(0o022)
    os.umask(before)
    return before
