"""What a diagnosis says of computer, program and bus: versions, configuration, interface, log. No secrets.

Each part is plain data for JSON. A part that cannot be had says why, in place of it: a diagnosis is made
where something is wrong.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import math
import platform
import re
import shutil
import subprocess
import sys
from collections import deque
from collections.abc import Mapping
from datetime import datetime
from importlib import metadata
from typing import Any

from canfb.bus.wall_clock import date_and_time
from canfb.configuration import Config

PACKAGES = ("canfb", "python-can", "canopen", "numpy", "PyYAML", "bokeh", "rich", "pylibiio", "uvloop")
MOST_LINES = 500
COMMAND_S = 5.0
UNITS = ("canfb", "canfb-interface")  # tools/systemd
SECRET = re.compile(r"pass|secret|token|credential|^key$|_key$", re.IGNORECASE)
IN_ADDRESS = re.compile(r"//[^/@\s]*@")
HIDDEN = "(left out)"


def versions() -> dict[str, Any]:
    """Of canfb, Python, what canfb uses, and the system."""
    packages: dict[str, str] = {}
    for name in PACKAGES:
        try:
            packages[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return {
        "packages": packages,
        "python": sys.version.split()[0],
        "system": f"{platform.system()} {platform.release()}",
        "machine": platform.machine(),
    }


def configuration_facts(config: Config) -> dict[str, Any]:
    """All keys with their values, defaults included."""
    facts: dict[str, Any] = plain(without_secrets(dataclasses.asdict(config)))
    return facts


def without_secrets(value: Any) -> Any:
    """The same without passwords, keys, and what stands before the @ of an address."""
    if isinstance(value, Mapping):
        return {
            name: HIDDEN if SECRET.search(str(name)) and one is not None else without_secrets(one)
            for name, one in value.items()
        }
    if isinstance(value, (list, tuple)):
        return [without_secrets(one) for one in value]
    return IN_ADDRESS.sub(f"//{HIDDEN}@", value) if isinstance(value, str) else value


def plain(value: Any) -> Any:
    """What JSON can hold: bytes in hexadecimal, and null for what is no number."""
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    if isinstance(value, (bytes, bytearray)):
        return value.hex()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)


def interface_facts(words: Mapping[str, Any]) -> dict[str, Any]:
    """Of the bus: its words, and for SocketCAN what ``ip`` says of the interface, state and counters."""
    channel = words.get("channel")
    facts: dict[str, Any] = {"words": plain(without_secrets(dict(words)))}
    if words.get("interface") == "socketcan" and isinstance(channel, str):
        facts["interface"] = _said(["ip", "-details", "-statistics", "link", "show", "dev", channel])
    return facts


def journal(name: str) -> list[str]:
    """The last lines of the services of this name, canfb@NAME and canfb-interface@NAME."""
    units = [word for unit in UNITS for word in ("-u", f"{unit}@{name}")]
    lines = ["-n", str(MOST_LINES), "-o", "short-iso", "--no-hostname", "--no-pager", "-q"]
    return _said(["journalctl", *units, *lines])


def _said(command: list[str]) -> list[str]:
    """The lines that a command prints; one line that says why not."""
    program = shutil.which(command[0])
    if program is None:
        return [f"{command[0]} is not there"]
    try:
        done = subprocess.run(
            [program, *command[1:]], capture_output=True, text=True, timeout=COMMAND_S, check=False
        )
    except (OSError, subprocess.SubprocessError) as error:
        return [f"{command[0]}: {error}"]
    return (done.stdout + done.stderr).splitlines()


class KeptLines(logging.Handler):
    """Keeps the last lines of a log."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: deque[tuple[float, str, str]] = deque(maxlen=MOST_LINES)

    def emit(self, record: logging.LogRecord) -> None:
        """Keep it."""
        self._lines.append((record.created, record.levelname, record.getMessage()))

    def lines(self) -> list[str]:
        """With the time of day and the level, the oldest first."""
        return [
            f"{datetime.fromtimestamp(at).astimezone().isoformat(' ', 'milliseconds')} {level} {text}"
            for at, level, text in list(self._lines)
        ]


def diagnosis_text(made_by: str, parts: Mapping[str, Any]) -> str:
    """The file: who made it and when, and then the parts in their order."""
    whole = {"canfb_diagnosis": 1, "made": date_and_time(), "made_by": made_by, **parts}
    return json.dumps(plain(whole), indent=1, ensure_ascii=False) + "\n"
